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
from jinja2 import BaseLoader, Environment
from markupsafe import Markup

from skymoor.registration.criteria import remedy_of
from skymoor.results.changes import changes_words
from skymoor.results.mosaic import Mosaic, mosaic_of
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.report import words
from skymoor.results.report.control import control_parts
from skymoor.results.report.figures import histogram
from skymoor.results.report.images import data_uri, difference_uri, file_uri

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
    remedy: str
    facts: list[tuple[str, str]]
    criteria: list[dict[str, Any]]
    figures: list[Figure] = field(default_factory=list)
    residuals: list[Markup] = field(default_factory=list)


def report_page(result: Result) -> str:
    """The page about a run, one HTML document that holds everything it shows."""
    mosaic = mosaic_of(result)
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
        satellite=None if mosaic.satellite is None else data_uri(mosaic.satellite),
        swipe=_swipe(mosaic),
        heights=_heights(mosaic),
        changes=_changes(result.folder),
        registered=result.registered_cameras,
        stages=_stages(result.summary.get("stages", [])),
        options=list(words.flattened(result.summary.get("options", {}))),
        provenance=list(words.flattened(result.summary.get("provenance", {}))),
    )
    return text


def _part(result: Result, component: ComponentSummary, position: int) -> Part:
    texts = (words.verdict(component), remedy_of(component.summary), words.facts(component), words.criteria(component))
    part = Part(component, position % COLOURS, *texts)
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
    asked = "airborne" if airborne else "ground"
    return any(not one.registered and one.image_set.startswith(asked) for one in result.components)


def _residuals(result: Result, component: ComponentSummary) -> list[Markup]:
    """Histograms of the inliers' residuals east, north and up."""
    metres = result.residuals(component)
    return [] if metres is None else [histogram(metres[:, k], name) for k, name in enumerate(("East", "North", "Up"))]


def _evaluation(folder: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
        return found if isinstance(found["rows"], list) else None
    except (OSError, ValueError, KeyError, TypeError):
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
    return {"dots": dots, "extent": extent, "box": [round(float(v), 1) for v in (*low, *(high - low))]}


def _swipe(mosaic: Mosaic) -> dict[str, str] | None:
    """Satellite and model around the model."""
    if mosaic.satellite is None or mosaic.model is None or mosaic.model_mask is None or not mosaic.model_mask.any():
        return None
    rows, columns = np.nonzero(mosaic.model_mask)
    part = np.s_[max(0, rows.min() - 8) : rows.max() + 9, max(0, columns.min() - 8) : columns.max() + 9]
    model = np.where(mosaic.model_mask[..., None], mosaic.model, mosaic.satellite // 2)
    return {"under": data_uri(mosaic.satellite[part]), "over": data_uri(model[part].astype(np.uint8))}


def _heights(mosaic: Mosaic) -> dict[str, Any] | None:
    difference = mosaic.height_difference
    if difference is None:
        return None
    return {"uri": difference_uri(difference), "histogram": histogram(difference, "Model minus reference")}


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
    environment = Environment(loader=BaseLoader(), autoescape=True, trim_blocks=True)
    environment.filters |= {"number": words.number, "share": words.share, "duration": words.duration}
    environment.globals |= {
        name: Markup((folder / file).read_text(encoding="utf-8"))  # of this package, not of the user
        for name, file in (("style", "page.css"), ("script", "page.js"))
    }
    return environment.from_string((folder / "page.html.j2").read_text(encoding="utf-8"))
