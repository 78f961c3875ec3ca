# SPDX-License-Identifier: Apache-2.0
"""The survey's figures in the report: the summary at the top, accuracies, lenses, the search, and files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from skymoor.results.read import ComponentSummary, Result
from skymoor.results.report import words
from skymoor.results.report.maps import Drawing, match_graph, overlap_map, search_map
from skymoor.results.report.words import NONE, number

NOT_DETERMINED = "not determined"
LENS_ROWS = (
    ("fx", "focal length x", "px", 2),
    ("fy", "focal length y", "px", 2),
    ("cx", "principal point x", "px", 2),
    ("cy", "principal point y", "px", 2),
    ("k1", "radial distortion k1", "", 5),
    ("k2", "radial distortion k2", "", 5),
    ("p1", "tangential distortion p1", "", 5),
    ("p2", "tangential distortion p2", "", 5),
)
ARROW = 0.07  # of the image's width: the longest residual in the drawing
FILES = (
    ("summary.json", "figures of this report"),
    ("statistics.json", "photos, match graph and overlap"),
    ("cameras.csv", "camera positions, orientations and accuracy"),
    ("cameras.geojson", "camera positions for GIS"),
    ("control.csv", "residuals of control and check points"),
    ("ortho.tif", "orthophoto of the model"),
    ("dsm.tif", "surface model, metres above the ellipsoid"),
    ("confidence.tif", "confidence of the surface model, percent"),
    ("pointcloud.laz", "point cloud"),
    ("change.tif", "height differences since the earlier run"),
    ("changes.geojson", "areas that changed since the earlier run"),
    ("evaluation.json", "errors against the truth"),
    ("run.log", "log of the run"),
    ("answers.json", "answers of a person"),
)
FOLDERS = (
    ("colmap", "COLMAP models"),
    ("renders", "renders"),
    ("matches", "matches"),
    ("placed", "given models, moved"),
)


@dataclass(frozen=True, eq=False)
class LensPart:
    """A lens: its name, a row (name, value, standard deviation) for each parameter, and residuals over the image."""

    name: str
    rows: list[tuple[str, str, str]]
    drawing: Markup
    words: str


@dataclass(frozen=True, eq=False)
class SearchPart:
    """The search of a component: what came first and second, the hypotheses as summary.json has them, and a map."""

    name: str
    words: str
    hypotheses: list[dict[str, Any]]
    drawing: Drawing | None


def summary_rows(result: Result) -> list[tuple[str, str]]:
    """Name and value of what the run is about; what a former version did not record is left out."""
    summary = result.summary
    systems, libraries = (
        summary.get("coordinate_systems") or {},
        (summary.get("provenance") or {}).get("libraries") or {},
    )
    used, stages = len(result.registered_cameras), summary.get("stages", [])
    seconds = summary.get("seconds", sum(one["seconds"] for one in stages))
    colmap = f", pycolmap {libraries['pycolmap']}" if libraries.get("pycolmap") else ""
    rows = [
        ("Date of the run", str(summary.get("date") or "").replace("T", " ").replace("+00:00", " UTC")),
        ("Software", f"skymoor {summary.get('skymoor', NONE)}{colmap}"),
        ("Coordinate system", _system(systems.get("crs"))),
        ("Heights of the products", _system(systems.get("heights"))),
        ("Heights of the reference", _system(systems.get("reference_heights"))),
        ("Photos with a position", f"{used} of {len(result.cameras)}"),
        ("Predicted accuracy (90 %)", _accuracy_words(result)),
        ("Processing time", words.duration(seconds) if stages else ""),
    ]
    return [row for row in rows if row[1]]


def _accuracy_words(result: Result) -> str:
    """CE90 and LE90 of the cameras of each registered component: what is asked for first."""
    told = []
    for one in result.components:
        if one.registered and one.ce90_m is not None:
            height = "" if one.le90_m is None else f", LE90 {number(one.le90_m, 1)} m"
            told.append(f"{one.image_set} {one.index}: CE90 {number(one.ce90_m, 1)} m{height}")
    return "; ".join(told)


def block_rows(result: Result) -> list[dict[str, str]]:
    """The figures of each component that has some, as texts."""
    rows = []
    for one in result.components:
        found = one.summary.get("statistics")
        if found:
            error = f"{number(found['mean_reprojection_px'])} px (RMS {number(found['rms_reprojection_px'])} px)"
            rows.append(
                {
                    "name": f"{one.image_set} {one.index}",
                    "photos": str(one.summary.get("n_cameras", NONE)),
                    "area": words.area(found["area_m2"]),
                    "gsd": words.small_length(found["gsd_m"]),
                    "tie_points": f"{found['n_tie_points']:,}".replace(",", " "),
                    "observations": f"{found['n_observations']:,}".replace(",", " "),
                    "track": number(found["mean_track_length"], 1),
                    "error": error,
                }
            )
    return rows


def accuracy_rows(component: ComponentSummary) -> list[tuple[str, list[str]]]:
    """Cameras and surface: CE90 and LE90 on Earth, and both relative to the reference, in metres."""
    if not component.registered:
        return []
    one, surface = component.summary, component.summary.get("surface_accuracy") or {}
    names = ("ce90_m", "le90_m", "relative_ce90_m", "relative_le90_m")
    rows = [("cameras", [one.get(f"predicted_{name}") for name in names]), ("surface", [surface.get(k) for k in names])]
    if component.heights == "NOT_CONFIRMED":
        rows = [(name, [a, None, b, None]) for name, (a, _, b, _) in rows]
    return [(name, [number(v) for v in values]) for name, values in rows if any(v is not None for v in values)]


def lens_parts(result: Result) -> list[LensPart]:
    """Every lens of every component."""
    parts = []
    for one in result.components:
        lenses = (one.summary.get("statistics") or {}).get("lenses", [])
        fields = (result.statistics.get(one.name) or {}).get("residuals", [])
        for k, lens in enumerate(lenses):
            name = f"{one.image_set} {one.index}" + (f", lens {k + 1} of {len(lenses)}" if len(lenses) > 1 else "")
            drawing, told = _residual_plot(lens, fields[k] if k < len(fields) else [], name)
            size = f"{lens['n_photos']} photos of {lens['width']} x {lens['height']} pixels"
            parts.append(LensPart(f"{name}: {size}", [_lens_row(lens, *row) for row in LENS_ROWS], drawing, told))
    return parts


def search_parts(result: Result, limit: int, *, ortho: bool) -> list[SearchPart]:
    """Of every component with hypotheses; the first `limit` with a map."""
    parts: list[SearchPart] = []
    searched = result.summary.get("search") or {}
    for one in result.components:
        found = one.summary.get("hypotheses") or []
        if found:
            bounds, places = searched.get("bounds_m"), [(h["east"], h["north"]) for h in found]
            drawn = (
                search_map(bounds, places, accepted=one.registered, ortho=ortho)
                if bounds and len(parts) < limit
                else None
            )
            parts.append(SearchPart(f"{one.image_set} {one.index}", _search_words(one, searched), found, drawn))
    return parts


def block_maps(result: Result, limit: int, *, ortho: bool) -> list[tuple[str, list[Drawing]]]:
    """Overlap map and match graph of the first `limit` registered components."""
    places = {
        (row.set, row.component, row.image): (row.east, row.north)
        for row in result.registered_cameras
        if row.east is not None and row.north is not None
    }
    parts: list[tuple[str, list[Drawing]]] = []
    for one in result.components:
        found, drawings = result.statistics.get(one.name) or {}, []
        if found.get("overlap"):
            drawings.append(overlap_map(found["overlap"], ortho=ortho))
        at = [places.get((one.image_set, one.index, row["image"])) for row in found.get("photos", [])]
        if found.get("shared_points") and sum(place is not None for place in at) > 1:
            drawings.append(match_graph(found["shared_points"], at, ortho=ortho))
        if drawings and len(parts) < limit:
            parts.append((f"{one.image_set} {one.index}", drawings))
    return parts


def run_files(folder: Path) -> list[tuple[str, str, str, str]]:
    """Relative address, name, content and size of the products that are there; folders end with a stroke."""
    found = [(name, what, folder / name) for name, what in FILES if (folder / name).is_file()]
    rows = [(quote(name), name, what, words.size(path.stat().st_size)) for name, what, path in found]
    for name, what in FOLDERS:
        files = [path for path in (folder / name).rglob("*") if path.is_file()] if (folder / name).is_dir() else []
        if files:
            total = sum(path.stat().st_size for path in files)
            rows.append((f"{name}/", f"{name}/", f"{what}, {len(files)} files", words.size(total)))
    return rows


def photo_verdict(status: str, component: int | None, *, contradicts: bool) -> str:
    """Of a photo, in a word or two."""
    if contradicts:
        return "contradicts its component"
    return "registered" if status == "REGISTERED" else "not reconstructed" if component is None else "refused"


def _system(found: Mapping[str, Any] | None) -> str:
    if not found:
        return ""
    return f"{found['name']} (EPSG:{found['epsg']})" if found.get("epsg") else f"{found['name']} (no EPSG code)"


def _lens_row(lens: Mapping[str, Any], key: str, name: str, unit: str, digits: int) -> tuple[str, str, str]:
    sigma = lens["sigma"].get(key)
    unit = f" {unit}" if unit else ""
    return name, number(lens[key], digits) + unit, NOT_DETERMINED if sigma is None else number(sigma, digits) + unit


def _residual_plot(lens: Mapping[str, Any], field: Sequence[Sequence[float]], name: str) -> tuple[Markup, str]:
    """Mean residuals over the image, enlarged, and how to read them."""
    rows = np.array(field, dtype=np.float64).reshape(-1, 5)
    if not len(rows):
        return Markup(""), ""
    lengths = np.hypot(rows[:, 2], rows[:, 3])
    longest = max(float(lengths.max()), 1e-6)
    times = float(f"{ARROW * lens['width'] / longest:.1g}")
    arrows = Markup("").join(_arrow(u, v, times * du, times * dv) for u, v, du, dv, _ in rows.tolist())
    label = f"Mean residuals over the image of {name}, at most {longest:.3f} px"
    svg = Markup(
        '<svg class="field" viewBox="0 0 {w} {h}" role="img" aria-label="{label}"><rect width="{w}" height="{h}"/>'
        '{arrows}<path class="principal" d="M{cx} {cy}m-{s} 0h{d}m-{s} -{s}v{d}"/></svg>'
    ).format(
        w=lens["width"],
        h=lens["height"],
        label=label,
        arrows=arrows,
        cx=f"{lens['cx']:.1f}",
        cy=f"{lens['cy']:.1f}",
        s=f"{lens['width'] / 50:.1f}",
        d=f"{lens['width'] / 25:.1f}",
    )
    told = (
        f"Mean residuals of the image points, observed minus projected, enlarged {times:g} times; the longest is "
        f"{longest:.3f} px. The cross is the principal point. A common direction or pattern is an error that the lens "
        "model does not describe."
    )
    return svg, told


def _arrow(u: float, v: float, du: float, dv: float) -> Markup:
    """With a head of two strokes."""
    x, y = u + du, v + dv
    left, right = ((0.3 * (-du * 0.87 + s * dv * 0.5), 0.3 * (-dv * 0.87 - s * du * 0.5)) for s in (1, -1))
    heads = "".join(f"M{x:.1f} {y:.1f}l{a:.1f} {b:.1f}" for a, b in (left, right))
    return Markup(f'<path d="M{u:.1f} {v:.1f}L{x:.1f} {y:.1f}{heads}"/>')


def _search_words(component: ComponentSummary, searched: Mapping[str, Any]) -> str:
    """Where the place was searched, and what came second."""
    return " ".join(_search_sentences(component, searched))


def _search_sentences(component: ComponentSummary, searched: Mapping[str, Any]) -> Iterator[str]:
    if searched and component.image_set == "airborne":
        whole = "The stated part of the reference" if searched["limited"] else "The whole reference"
        yield f"{whole} was searched, {words.area(searched['area_m2'])} with imagery."
    first, *others = component.summary["hypotheses"]
    decided = "was accepted" if component.registered else "was refused"
    yield f"The best hypothesis, which {decided}, has a score of {number(first['score'], 1)}."
    if not others:
        yield "No second one was found."
        return
    second = others[0]
    away = float(np.hypot(second["east"] - first["east"], second["north"] - first["north"]))
    yield f"The second has {number(second['score'], 1)}, {number(away, 0)} m from it."
    decoy = (component.summary.get("diagnostics") or {}).get("decoy_score")
    if decoy is not None:
        yield f"Decoys, which match nowhere, reached {number(decoy, 1)}."
