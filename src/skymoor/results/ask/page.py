# SPDX-License-Identifier: Apache-2.0
"""The page that asks: one HTML document that holds everything it shows, in the style of the report."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import BaseLoader, Environment
from markupsafe import Markup

from skymoor.geo import EnuFrame
from skymoor.registration.criteria import remedy_of
from skymoor.results.ask.question import Place, Question, cut_out
from skymoor.results.mosaic import mosaic_of
from skymoor.results.read import Result
from skymoor.results.report.images import data_uri, file_uri
from skymoor.results.report.words import number

RENDER_PX, PLACE_PX, MAP_PX = 900, 480, 1600


@dataclass(frozen=True, eq=False)
class Shown:
    """A question with its images as data URIs; None for those that are missing."""

    question: Question
    remedy: str
    render: str | None
    places: tuple[tuple[Place, str | None], ...]


@dataclass(frozen=True, eq=False)
class Map:
    """The reference as the page shows it: its extent in metres, and its corners' latitude and longitude for clicks."""

    uri: str
    west: float
    south: float
    east: float
    north: float
    corners: str


class AskPage:
    """The page about some questions; its images are made once."""

    def __init__(self, result: Result, questions: list[Question]) -> None:
        self._result = result
        self._shown = [_shown(result, one) for one in questions]
        self._map, self._note = _map(result)

    def asking(self, error: str = "") -> bytes:
        """The page, and what was wrong with the answer before."""
        return self._page("ask", error)

    def thanking(self, words: str) -> bytes:
        """The page after an answer."""
        return self._page("thanks", words)

    def _page(self, kind: str, message: str) -> bytes:
        text: str = _template().render(
            kind=kind,
            message=message,
            site=self._result.summary.get("site", ""),
            version=self._result.summary.get("skymoor", ""),
            shown=self._shown,
            map=self._map,
            note=self._note,
        )
        return text.encode()


def _shown(result: Result, question: Question) -> Shown:
    file = result.folder / "renders" / f"{question.name}_nadir_rgb.png"
    cuts = (None if question.render is None else cut_out(result, question.render, place) for place in question.places)
    uris = [None if cut is None else data_uri(cut, PLACE_PX) for cut in cuts]
    return Shown(
        question,
        remedy_of(question.component.summary),
        None if question.render is None else file_uri(file, RENDER_PX),
        tuple(zip(question.places, uris, strict=True)),
    )


def _map(result: Result) -> tuple[Map | None, str]:
    """The reference, and why it is missing."""
    mosaic = mosaic_of(result)
    if mosaic.grid is None or mosaic.satellite is None:
        return None, mosaic.note or f"{Path(str(result.folder)) / 'summary.json'}: the reference cannot be read"
    west, south, east, north = mosaic.grid.bounds
    corners = _lat_lon(result.frame, [[west, north], [east, north], [west, south], [east, south]])
    return Map(data_uri(mosaic.satellite, MAP_PX), west, south, east, north, corners), mosaic.note


def _lat_lon(frame: EnuFrame, plan: list[list[float]]) -> str:
    """Of the corners of the map; between them a page interpolates, to a few centimetres in a few kilometres."""
    lla = frame.lla_from_enu(np.column_stack([np.array(plan), np.zeros(len(plan))]))
    return " ".join(f"{value:.8f}" for value in lla[:, :2].ravel())


@cache
def _template() -> Any:
    own, report = files("skymoor.results.ask"), files("skymoor.results.report")
    environment = Environment(loader=BaseLoader(), autoescape=True, trim_blocks=True)
    environment.filters["number"] = number
    environment.globals |= {  # of this package, not of the user
        "style": Markup((report / "page.css").read_text(encoding="utf-8")),
        "own_style": Markup((own / "page.css").read_text(encoding="utf-8")),
        "script": Markup((own / "page.js").read_text(encoding="utf-8")),
    }
    return environment.from_string((own / "page.html.j2").read_text(encoding="utf-8"))
