# SPDX-License-Identifier: Apache-2.0
"""The content of the report, gathered from the folder of a run; the template lays it out."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import DictLoader, Environment
from markupsafe import Markup

from skymoor.engines.regular import regular
from skymoor.registration.criteria import remedy_of
from skymoor.results.changes import changes_words
from skymoor.results.mosaic import Mosaic, mosaic_of
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.report import words
from skymoor.results.report.control import control_parts
from skymoor.results.report.figures import histogram
from skymoor.results.report.images import data_uri, file_uri
from skymoor.results.report.maps import (
    OPENSTREETMAP,
    ellipse,
    enlarged_words,
    enlargement,
    furniture,
    length_words,
    scale_length,
)
from skymoor.results.report.surfaces import height_differences, shaded_surface
from skymoor.results.report.survey import (
    accuracy_rows,
    block_maps,
    block_rows,
    lens_parts,
    photo_verdict,
    run_files,
    search_parts,
    summary_rows,
)

COLOURS = 6  # of components on the map; the style has as many
MAX_ILLUSTRATED = 6  # components with figures: a page of many hundred small components must still open
FIGURES = (
    ("renders", "nadir_rgb", "From above", "The model rendered from above"),
    ("renders", "nadir_height", "Heights", "Heights of the model, dark low and bright high"),
    ("renders", "nadir_confidence", "Confidence", "Confidence of the model's heights, bright is high"),
    ("matches", "overlay", "Checkerboard", "Registered model and reference in alternate squares: roads must continue"),
    (
        "matches",
        "residuals",
        "Residuals",
        "Residuals of the inliers, arrows enlarged 50 times, red too high, blue too low",
    ),
    ("matches", "matches", "Matches", "Render and reference with lines between matches, inliers in green"),
    ("matches", "walls", "Walls", "The same walls from ground photos, from airborne photos, and in alternate squares"),
    ("matches", "plan", "Plan", "The orthophoto with cameras in yellow, walls in red and free space in blue"),
)
WIDE, HALF = {"matches", "walls", "plan"}, {"overlay", "residuals"}
SIDES_PX = {"third": 700, "half": 1000, "wide": 1400}


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure of the page."""

    uri: str
    title: str
    alt: str
    size: str  # "third" of the page's width, "half" or "wide"


@dataclass(frozen=True, eq=False)
class Part:
    """A component as the page shows it."""

    component: ComponentSummary
    colour: int
    verdict: str
    plain: str
    remedy: str
    accuracy: list[tuple[str, list[str]]]
    facts: list[tuple[str, str]]
    criteria: list[dict[str, Any]]
    figures: list[Figure] = field(default_factory=list)
    residuals: list[Markup] = field(default_factory=list)


def report_page(result: Result, mosaic: Mosaic | None = None) -> str:
    """The page about a run, one HTML document that holds everything it shows; `mosaic` is its, where it was read."""
    mosaic = mosaic_of(result) if mosaic is None else mosaic
    ortho = mosaic.satellite is not None and mosaic.grid is not None
    parts = [_part(result, one, k) for k, one in enumerate(result.components)]
    text: str = _template().render(
        result=result,
        summary=result.summary,
        parts=parts,
        lost=[one for one in result.summary["sets"] if not one["components"]],
        lost_remedy=words.LOST_REMEDY,
        person=words.person_words(result.summary),
        asked=has_question(result),
        glossary=words.GLOSSARY,
        evaluation=_evaluation(result.folder),
        control=control_parts(result.summary),
        mosaic=mosaic,
        map=_map(result, mosaic),
        basemap=OPENSTREETMAP,
        satellite=None if mosaic.satellite is None else data_uri(mosaic.satellite),
        swipe=_swipe(mosaic),
        overview=summary_rows(result),
        blocks=block_rows(result),
        lenses=lens_parts(result),
        drawings=block_maps(result, MAX_ILLUSTRATED, ortho=ortho),
        search=search_parts(result, MAX_ILLUSTRATED, ortho=ortho),
        photos=_photos(result),
        files=run_files(result.folder),
        surface=shaded_surface(mosaic, result.frame.height_m),
        heights=height_differences(mosaic),
        changes=_changes(result.folder),
        registered=result.registered_cameras,
        stages=_stages(result.summary.get("stages", [])),
        options=list(words.flattened(result.summary.get("options", {}))),
        provenance=list(words.flattened(result.summary.get("provenance", {}))),
    )
    return text


def _part(result: Result, component: ComponentSummary, position: int) -> Part:
    part = Part(
        component,
        position % COLOURS,
        verdict=words.verdict(component),
        plain=words.plain_words(component),
        remedy=remedy_of(component.summary),
        accuracy=accuracy_rows(component),
        facts=words.facts(component),
        criteria=words.criteria(component),
    )
    if position >= MAX_ILLUSTRATED:
        return part
    figures = []
    for kind, name, title, alt in FIGURES:
        size = "wide" if name in WIDE else "half" if name in HALF else "third"
        uri = file_uri(result.folder / kind / f"{component.name}_{name}.png", SIDES_PX[size])
        if uri is not None:
            figures.append(Figure(uri, title, f"{alt} ({component.name})", size))
    return replace(part, figures=figures, residuals=_residuals(result, component))


def has_question(result: Result) -> bool:
    """Whether `skymoor ask` has a question about this run."""
    airborne = any(one.image_set == "airborne" for one in result.components)
    return any(not one.registered and (one.image_set == "airborne" or not airborne) for one in result.components)


def _residuals(result: Result, component: ComponentSummary) -> list[Markup]:
    """Histograms of the inliers' residuals east, north and up."""
    metres = result.residuals(component)
    return [] if metres is None else [histogram(metres[:, k], name) for k, name in enumerate(("East", "North", "Up"))]


def _evaluation(folder: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(regular(folder / "evaluation.json").read_text(encoding="utf-8"))
        return found if isinstance(found["rows"], list) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _map(result: Result, mosaic: Mosaic) -> dict[str, Any] | None:
    """The map's frame (metres, y to the south), its cameras, and where all of them can be seen."""
    colours = {one.name: k % COLOURS for k, one in enumerate(result.components)}
    dots = [
        {
            "x": round(row.east, 2),
            "y": round(-row.north, 2),
            "row": row,
            "colour": colours.get(f"{row.set}_{row.component}", 0),
        }
        for row in result.cameras
        if row.east is not None and row.north is not None
    ]
    extent = mosaic.grid.bounds if mosaic.grid is not None else None
    if not dots and extent is None:
        return None
    xy = np.array([[dot["x"], dot["y"]] for dot in dots], dtype=np.float64).reshape(-1, 2)
    corners = xy if extent is None else np.vstack([xy, [[extent[0], -extent[3]], [extent[2], -extent[1]]]])
    low, high = corners.min(axis=0) - 5, corners.max(axis=0) + 5
    box = (*low.tolist(), *(high - low).tolist())
    frame = {"extent": extent, "box": [round(value, 1) for value in box], "furniture": furniture(box)}
    return {"dots": dots} | frame | _ellipses(result, dots, box)


def _ellipses(result: Result, dots: list[dict[str, Any]], box: tuple[float, ...]) -> dict[str, Any]:
    """Error ellipses around the cameras, on Earth and relative to the reference, each with the words on its scale.

    Runs of former versions have no ellipses: circles of CE90 stand for them.
    """
    found = {name: {row["image"]: row for row in one["photos"]} for name, one in result.statistics.items()}
    drawn: dict[str, Any] = {}
    for css, key, ce90 in (("ce90", "ellipse_90", "ce90"), ("relative", "relative_ellipse_90", "relative_ce90")):
        axes = []
        for dot in dots:
            row = dot["row"]
            own = found.get(f"{row.set}_{row.component}", {}).get(row.image, {}).get(key)
            radius = getattr(row, ce90)
            axes.append(own or (None if radius is None else [radius, radius, 0.0]))
        times = enlargement([one[0] for one in axes if one is not None], box)
        pairs = [(dot, one) for dot, one in zip(dots, axes, strict=True) if one is not None]
        drawn[css] = [ellipse(dot["x"], dot["y"], one, times, f"{css} c{dot['colour']}") for dot, one in pairs]
        drawn[f"{css}_words"] = enlarged_words(times)
    return drawn


def _photos(result: Result) -> list[dict[str, Any]]:
    """A row for each photo: its line of cameras.csv, the figures of its tie points, and its verdict."""
    found = {name: {row["image"]: row for row in one["photos"]} for name, one in result.statistics.items()}
    doubted = {(one.name, image) for one in result.components for image in one.summary.get("contradicting_cameras", ())}
    rows = []
    for row in result.cameras:
        name = f"{row.set}_{row.component}"
        verdict = photo_verdict(row.status, row.component, contradicts=(name, row.image) in doubted)
        rows.append({"row": row, "tie": found.get(name, {}).get(row.image, {}), "verdict": verdict})
    return rows


def _swipe(mosaic: Mosaic) -> dict[str, str] | None:
    """Satellite and model around the model, and a scale bar: its share of the width in percent, and its length."""
    if (
        mosaic.grid is None
        or mosaic.satellite is None
        or mosaic.model is None
        or mosaic.model_mask is None
        or not mosaic.model_mask.any()
    ):
        return None
    rows, columns = np.nonzero(mosaic.model_mask)
    part = np.s_[max(0, rows.min() - 8) : rows.max() + 9, max(0, columns.min() - 8) : columns.max() + 9]
    model = np.where(mosaic.model_mask[..., None], mosaic.model, mosaic.satellite // 2)
    wide_m = mosaic.satellite[part].shape[1] * mosaic.grid.pixel_m
    length = scale_length(wide_m)
    scale = {"share": f"{100 * length / wide_m:.2f}", "length": length_words(length)}
    return scale | {"under": data_uri(mosaic.satellite[part]), "over": data_uri(model[part].astype(np.uint8))}


def _changes(folder: Path) -> dict[str, str] | None:
    """What changed since the earlier run that this one was registered on."""
    told, uri = changes_words(folder), file_uri(folder / "matches" / "change.png", SIDES_PX["wide"])
    return {"words": told, "uri": uri} if told and uri else None


def _stages(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    longest = max((one["seconds"] for one in records), default=1.0) or 1.0
    return [one | {"width": round(100 * one["seconds"] / longest, 1)} for one in records]


@cache
def _template() -> Any:
    folder = files("skymoor.results.report")
    names = ("page.html.j2", "page.survey.html.j2", "page.photos.html.j2")
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in names}
    environment = Environment(loader=DictLoader(texts), autoescape=True, trim_blocks=True)
    filters = (words.number, words.share, words.duration)
    environment.filters |= {one.__name__: one for one in filters}
    environment.globals |= {
        name: Markup((folder / file).read_text(encoding="utf-8"))  # of this package, not of the user
        for name, file in (("style", "page.css"), ("script", "page.js"))
    }
    return environment.get_template("page.html.j2")
