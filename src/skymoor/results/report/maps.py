# SPDX-License-Identifier: Apache-2.0
"""Maps of the report in SVG: local metres, north up, each with a scale bar and a north arrow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from skymoor.results.report.images import png_uri
from skymoor.results.report.words import number
from skymoor.types import Array

Box = tuple[float, float, float, float]
"""West, top (minus north, since y of an SVG goes down), width and height in metres."""

LETTERS = 0.034  # of the map's longer side
BAR = 0.28  # of the map's width at most
ROUND = (5.0, 2.0, 1.0)
ENLARGED = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
VISIBLE = 0.012  # of the map's longer side, which the middle ellipse should reach
OVERLAP = ((1, "#b3261a"), (2, "#ee8a4a"), (3, "#f8d877"), (4, "#b7dd79"), (6, "#4fae5b"), (9, "#14693a"))
"""From how many photos on, and the colour."""
WIDEST_PX, FINEST_PX = 5.0, 0.6  # of lines of the match graph


@dataclass(frozen=True)
class Basemap:
    """A web map in tiles of the Web Mercator projection, which the reader of a report may load behind its map.

    Attributes:
        host: whose connection is opened, as the button says.
        tiles: address of a tile, with {z}, {x} and {y}.
        finest: the largest zoom level that there is.
        credit, terms: whom the map is from, and the address of the terms, which it is shown with.
    """

    host: str
    tiles: str
    finest: int
    credit: str
    terms: str


OPENSTREETMAP = Basemap(
    host="tile.openstreetmap.org",
    tiles="https://tile.openstreetmap.org/{z}/{x}/{y}.png",
    finest=19,
    credit="OpenStreetMap contributors",
    terms="https://www.openstreetmap.org/copyright",
)


@dataclass(frozen=True)
class Drawing:
    """A map with what stands below it: its legend as pairs of colour and text, and a sentence."""

    svg: Markup
    words: str
    legend: tuple[tuple[str, str], ...] = ()


def box_around(xy: Array, margin: float = 0.08) -> Box:
    """Around positions (n, 2) east, north in metres."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    spare = max(margin * float((high - low).max()), 2.0)
    (west, south), (east, north) = (low - spare).tolist(), (high + spare).tolist()
    return west, -north, east - west, north - south


def scale_length(width_m: float) -> float:
    """The longest round length, 1, 2 or 5 times a power of ten, that suits a map so wide."""
    power = 10.0 ** np.floor(np.log10(BAR * width_m))
    return float(next(digit * power for digit in (*ROUND, 0.5) if digit * power <= BAR * width_m * (1 + 1e-9)))


def length_words(metres: float) -> str:
    """Of a scale bar."""
    return f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m"


def furniture(box: Box) -> Markup:
    """A scale bar at the lower left, and a north arrow at the upper right."""
    x, y, width, height = box
    size = LETTERS * max(width, height)
    length = scale_length(width)
    text = length_words(length)
    left, foot, right, top = x + size, y + height - size, x + width - 1.4 * size, y + 0.8 * size
    return Markup(
        '<g class="furniture" font-size="{size}"><path d="M{left} {mark}V{foot}H{end}V{mark}"/>'
        '<text x="{middle}" y="{above}" text-anchor="middle">{text}</text>'
        '<path class="needle" d="M{right} {top}l{half} {long}l-{half} -{short}l-{half} {short}Z"/>'
        '<text x="{right}" y="{below}" text-anchor="middle">N</text></g>'
    ).format(
        text=text,
        **_rounded(
            size=size,
            left=left,
            foot=foot,
            end=left + length,
            mark=foot - 0.4 * size,
            middle=left + length / 2,
            above=foot - 0.55 * size,
            right=right,
            top=top,
            half=0.45 * size,
            long=1.5 * size,
            short=0.4 * size,
            below=top + 2.6 * size,
        ),
    )


def map_svg(box: Box, label: str, layers: Markup, *, ortho: bool = False) -> Markup:
    """A map of some layers, on the orthophoto that the page holds once."""
    under = Markup('<use href="#ortho" class="faint"/>') if ortho else Markup("")
    return Markup(
        '<svg class="plan" viewBox="{box}" role="img" aria-label="{label}">{under}{layers}{furniture}</svg>'
    ).format(box=" ".join(f"{v:.2f}" for v in box), label=label, under=under, layers=layers, furniture=furniture(box))


def raster_layer(uri: str, bounds: Sequence[float], css: str = "") -> Markup:
    """An image between west, south, east and north."""
    west, south, east, north = bounds
    return Markup(
        '<image class="{css}" href="{uri}" x="{x}" y="{y}" width="{w}" height="{h}" preserveAspectRatio="none"/>'
    ).format(css=css, uri=uri, **_rounded(x=west, y=-north, w=east - west, h=north - south))


def overlap_map(found: Mapping[str, Any], *, ortho: bool) -> Drawing:
    """How many photos show each place."""
    counts = np.array(found["counts"], dtype=np.int64)
    rgba = np.zeros((*counts.shape, 4), np.uint8)
    for least, colour in OVERLAP:
        rgba[counts >= least] = [*(int(colour[k : k + 2], 16) for k in (1, 3, 5)), 200]
    rows, columns = counts.shape
    west, north, cell = found["west"], found["north"], found["cell_m"]
    bounds = west, north - rows * cell, west + columns * cell, north
    box = box_around(np.array([[bounds[0], bounds[1]], [bounds[2], bounds[3]]]))
    seen = counts[counts > 0]
    middle = int(np.median(seen)) if len(seen) else 0
    layer = raster_layer(png_uri(rgba), bounds, "cells")
    label = f"Overlap map, north up: up to {counts.max()} photos show one place, {middle} in the median"
    ends = [*(str(nxt - 1) for nxt, _ in OVERLAP[1:]), ""]
    legend = tuple(
        (colour, f"{least}" if end == f"{least}" else f"{least} to {end}" if end else f"{least} or more")
        for (least, colour), end in zip(OVERLAP, ends, strict=True)
    )
    words = (
        f"How many photos show each place of the ground, {middle} in the median and {counts.max()} at most. "
        "Heights rest on places that two or more show; three or more reveal errors."
    )
    return Drawing(map_svg(box, label, layer, ortho=ortho), words, legend)


def match_graph(
    pairs: Sequence[Sequence[int]], places: Sequence[tuple[float, float] | None], *, ortho: bool
) -> Drawing:
    """Photos at their `places` (east, north), with a line between those that share tie points, wide for many."""
    drawn = [(a, b, n) for a, b, n in pairs if places[a] is not None and places[b] is not None]
    known = [place for place in places if place is not None]
    most = max((n for _, _, n in drawn), default=1)
    lines, dots = [], []
    for a, b, n in sorted(drawn, key=lambda pair: pair[2]):
        (x0, y0), (x1, y1) = places[a], places[b]  # type: ignore[misc]  # filtered above
        wide = FINEST_PX + (WIDEST_PX - FINEST_PX) * n / most
        lines.append(f'<path d="M{x0:.2f} {-y0:.2f}L{x1:.2f} {-y1:.2f}" style="stroke-width:{wide:.1f}px"/>')
    dots += [f'<path d="M{x:.2f} {-y:.2f}h0"/>' for x, y in known]
    layer = Markup('<g class="edges">' + "".join(lines) + '</g><g class="nodes">' + "".join(dots) + "</g>")
    least = min((n for _, _, n in drawn), default=0)
    points = f"{least} tie point{'' if least == 1 else 's'}"
    words = (
        f"Lines join photos with common tie points, the strongest neighbours of each: {points} where they are finest, "
        f"{most} where they are widest. A thin waist is where a block can bend."
    )
    label = f"Match graph, north up: {len(known)} photos and {len(drawn)} pairs"
    return Drawing(map_svg(box_around(np.array(known)), label, layer, ortho=ortho), words)


def search_map(
    bounds: Sequence[float], places: Sequence[tuple[float, float]], *, accepted: bool, ortho: bool
) -> Drawing:
    """The area that was searched, and the hypotheses by number; the first is green where it was accepted."""
    west, south, east, north = bounds
    box = box_around(np.array([[west, south], [east, north], *places]))
    size = LETTERS * max(box[2:])
    area = Markup('<rect class="searched" x="{x}" y="{y}" width="{w}" height="{h}"/>').format(
        **_rounded(x=west, y=-north, w=east - west, h=north - south)
    )
    marks = [
        Markup('<g class="mark{first}" font-size="{size}"><circle cx="{x}" cy="{y}" r="{r}"/>'
               '<text x="{x}" y="{foot}" text-anchor="middle">{k}</text></g>').format(
            first=" first" if accepted and k == 0 else "", k=k + 1,
            **_rounded(size=size, x=x, y=-y, r=0.85 * size, foot=-y + 0.36 * size),
        )
        for k, (x, y) in reversed(list(enumerate(places)))
    ]  # fmt: skip
    label = f"Map of the search, north up: {len(places)} hypotheses in the area that was searched"
    return Drawing(map_svg(box, label, Markup("").join([area, *marks]), ortho=ortho), "")


def enlargement(lengths_m: Sequence[float], box: Sequence[float]) -> int:
    """The least round factor by which ellipses with semi-axes of these lengths can be seen on a map."""
    if not lengths_m:
        return 1
    wanted = VISIBLE * max(box[2], box[3]) / max(float(np.median(lengths_m)), 1e-9)
    return next((times for times in ENLARGED if times >= wanted), ENLARGED[-1])


def ellipse(x: float, y: float, axes: Sequence[float], times: int, css: str) -> Markup:
    """An error ellipse of semi-axes and azimuth around a place of the map."""
    major, minor, azimuth = axes
    return Markup(
        '<ellipse class="{css}" cx="{x}" cy="{y}" rx="{rx}" ry="{ry}" transform="rotate({turn} {x} {y})"/>'
    ).format(css=css, x=x, y=y, rx=f"{times * major:.3f}", ry=f"{times * minor:.3f}", turn=f"{azimuth - 90:.1f}")


def enlarged_words(times: int) -> str:
    """How large ellipses are drawn."""
    return "drawn to scale" if times == 1 else f"drawn {number(times, 0)} times enlarged"


def _rounded(**values: float) -> dict[str, str]:
    return {name: f"{value:.2f}" for name, value in values.items()}
