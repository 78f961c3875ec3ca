# SPDX-License-Identifier: Apache-2.0
"""What a person's answer means for the search: a prior with its own uncertainty, and a record of who stated what."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from math import cos, hypot, isfinite, radians
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.engines.regular import regular
from skymoor.errors import InputError
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import Options
from skymoor.pipeline.prior import HEIGHT_TOLERANCE, Person, SearchPrior, plain_prior
from skymoor.reference.raster import MapRaster
from skymoor.results.ask.question import Place, Question, RenderFrame
from skymoor.results.read import Result
from skymoor.results.request import changed_options
from skymoor.store import Store

Box = tuple[float, float, float, float]

ANSWERS = "answers.json"
POINT_M = 25.0
"""How far a point that a person picks on a map may be from the point that is meant: of two seasons, a crossing or a
corner is found within a few pixels of a coarse map."""
SPARE_M = 20.0  # around a place that is chosen, beside a quarter of its size
METRES_PER_DEGREE = 111_000.0
PLACES = ("candidate", "near", "area", "point")
NORTHS = ("heading", "north")
SIZES = ("height", "length")


@dataclass(frozen=True)
class Statement:
    """What a person stated of one component; None and "" for what was not.

    Attributes:
        candidate: number of a place of the question, from 1.
        near: latitude, longitude and a radius in metres.
        area: west, south, east and north in degrees.
        point: pixel (u, v) of the render, and latitude and longitude of the same spot on the map.
        heading: degrees of the first photo, or PHOTO=DEGREES.
        north: degrees, clockwise from the upper edge of the render.
        height: flying height in metres.
        length: two pixels (u, v, u, v) of the render, and the metres between them.
        by: who says so.
    """

    candidate: int | None = None
    near: tuple[float, ...] | None = None
    area: tuple[float, ...] | None = None
    point: tuple[float, ...] | None = None
    heading: str | None = None
    north: float | None = None
    height: float | None = None
    length: tuple[float, ...] | None = None
    by: str = ""

    @property
    def stated(self) -> dict[str, Any]:
        """What was stated, by its name."""
        values = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "by"}
        return {name: value for name, value in values.items() if value is not None}


def person_of(result: Result, question: Question, statement: Statement) -> Person:
    """The prior that follows, and its record. Raises `InputError`, one line, for what makes no sense or is nothing."""
    stated = statement.stated
    if not stated:
        raise InputError("nothing was stated: choose a place, or give a point, an area, a direction or a height")
    for group in (PLACES, NORTHS, SIZES):
        named = [name for name in group if name in stated]
        if len(named) > 1:
            raise InputError(f"{' and '.join(named)} say the same thing twice; give one of them")
    place = None if statement.candidate is None else _chosen(question, statement.candidate)
    others = [one for one in result.components if one.registered and one.image_set == question.component.image_set]
    prior = SearchPrior.of(
        statement.area,
        _near(result, question, statement, place),
        _heading(question, statement, place),
        _height(question, statement, place),
        where="",
    )
    _require_on_map(result, prior.area)
    if others:  # which are to keep their places
        prior = SearchPrior(_widened(prior.area, result), prior.heading, None)
    record = {
        "component": question.name,
        "by": statement.by.strip(),
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "stated": stated,
        "prior": plain_prior(prior),
        "height_factor": HEIGHT_TOLERANCE if prior.height_m is not None else None,
        "words": words_of(statement, prior),
    }
    return Person(prior, record)


def words_of(statement: Statement, prior: SearchPrior) -> str:
    """What was stated and how far it is believed, for the screen and the report."""
    texts = {
        "candidate": f"place {statement.candidate} was chosen",
        "near": "a point and a radius were given",
        "area": "the area was given",
        "point": "a point was picked on render and map",
        "heading": "the direction of a photo was given",
        "north": "north was given on the render",
        "height": "the flying height was given",
        "length": "a length was given",
    }
    said = " and ".join(texts[name] for name in statement.stated)
    limits = []
    if prior.area is not None:
        west, south, east, north = prior.area
        limits.append(f"latitude {south:.5f} to {north:.5f} and longitude {west:.5f} to {east:.5f}")
    if prior.heading is not None:
        limits.append(f"directions within {prior.heading.tolerance_deg:.0f} degrees")
    if prior.height_m is not None:
        low, high = prior.height_m / HEIGHT_TOLERANCE, prior.height_m * HEIGHT_TOLERANCE
        limits.append(f"flying heights of {low:.0f} to {high:.0f} m")
    return f"{said}: the search is bounded to {', '.join(limits)}" if limits else said


def record_answer(store: Store, person: Person) -> None:
    """Add an answer to answers.json of the run."""
    store.write_json(ANSWERS, {"answers": [*answers_of(store.path(ANSWERS)), person.record]})


def answers_of(file: Path) -> Sequence[Mapping[str, Any]]:
    """The answers that were given before; none where the file is missing or damaged."""
    try:
        found = json.loads(regular(file).read_text(encoding="utf-8"))["answers"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
    return found if isinstance(found, list) else []


def _chosen(question: Question, number: int) -> Place:
    count = len(question.places)
    if not 1 <= number <= count:
        there = f"give a number from 1 to {count}" if count else "the run found no place that came into question"
        raise InputError(f"candidate {number}: {there}")
    return question.places[number - 1]


def _near(result: Result, question: Question, statement: Statement, place: Place | None) -> tuple[float, ...] | None:
    """Latitude, longitude, and a radius in metres that holds all of the model."""
    render = question.render
    if place is not None:
        reach = 1.0 if render is None else render.reach
        return place.lat, place.lon, HEIGHT_TOLERANCE * reach * place.height_m + SPARE_M
    if statement.point is None:
        return _numbers(statement.near, 3, "near")
    u, v, lat, lon = _numbers(statement.point, 4, "point") or (0.0,) * 4
    frame = _in_render(question, (u, v))
    highest = _height(question, statement, None)
    highest = _options(result).match.max_height_m if highest is None else highest * HEIGHT_TOLERANCE
    return lat, lon, frame.reach_from(u, v) * highest + POINT_M


def _heading(question: Question, statement: Statement, place: Place | None) -> str | None:
    """Of a photo, as `Heading.parsed` reads it."""
    if statement.heading is not None:
        return statement.heading
    if statement.north is not None and not -360 <= statement.north <= 360:
        raise InputError(f"north {statement.north:g}: give degrees clockwise from the upper edge of the render")
    if statement.north is not None and question.first_photo is None:
        raise InputError("north: this run did not record how its photos lie in the render; give a heading instead")
    azimuth = -statement.north if statement.north is not None else None if place is None else place.azimuth_deg
    if azimuth is None or question.first_photo is None:
        return None
    image, own = question.first_photo
    return f"{image}={(own + azimuth) % 360:.2f}"


def _height(question: Question, statement: Statement, place: Place | None) -> float | None:
    """The flying height in metres, which is the unit of the level frame."""
    if statement.height is not None:
        return statement.height
    if statement.length is None:
        return None if place is None else place.height_m
    u0, v0, u1, v1, metres = _numbers(statement.length, 5, "length") or (0.0,) * 5
    frame = _in_render(question, (u0, v0), (u1, v1))
    units = frame.pixel * hypot(u1 - u0, v1 - v0)
    if units == 0 or not metres > 0:
        raise InputError("length: give two different points of the render, and the metres between them")
    return metres / units


def _in_render(question: Question, *pixels: tuple[float, float]) -> RenderFrame:
    """The frame of the render, which holds these pixels."""
    render = question.render
    if render is None:
        raise InputError(f"{question.name}: has no render, so no point on it can be given")
    rows, columns = render.shape
    for u, v in pixels:
        if not (0 <= u <= columns and 0 <= v <= rows):
            raise InputError(f"point {u:g} {v:g}: lies outside of the render, which has {columns} by {rows} pixels")
    return render


def _numbers(values: Sequence[float] | None, count: int, name: str) -> tuple[float, ...] | None:
    if values is None:
        return None
    if len(values) != count or not all(isfinite(one) for one in values):
        raise InputError(f"{name}: give {count} numbers")
    return tuple(values)


def _require_on_map(result: Result, area: Box | None) -> None:
    """Raises `InputError` for an area beside the reference, such as one with latitude and longitude exchanged."""
    ortho = Path(result.summary["reference"]["ortho"])
    if area is None or not ortho.is_file():
        return
    raster = MapRaster.of(ortho)
    lonlat = raster.lonlat_from_px(raster.border_px())
    low, high = np.maximum(lonlat.min(axis=0), area[:2]), np.minimum(lonlat.max(axis=0), area[2:])
    if (low >= high).any():
        raise InputError(f"what was stated lies outside of the map: {raster.extent()}; check the numbers")


def _widened(area: Box | None, result: Result) -> Box | None:
    """An area that holds the registered cameras, and what they see, as well."""
    there = [(row.lon, row.lat) for row in result.cameras if row.lon is not None and row.lat is not None]
    if area is None or not there:
        return area
    west, south, east, north = area
    longitudes, latitudes = zip(*there, strict=True)
    margin = _options(result).match.max_height_m / METRES_PER_DEGREE
    across = margin / max(0.01, cos(radians(south)))
    return (
        min(west, min(longitudes) - across),
        min(south, min(latitudes) - margin),
        max(east, max(longitudes) + across),
        max(north, max(latitudes) + margin),
    )


def _options(result: Result) -> Options:
    return with_options(Options(), changed_options(result), f"{result.folder / 'summary.json'}")
