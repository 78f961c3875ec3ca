# SPDX-License-Identifier: Apache-2.0
"""What a person is asked about a refused component: its render, and the places that came into question."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skymoor.engines.regular import arrays_of
from skymoor.errors import InputError
from skymoor.reference.read import read_part
from skymoor.results.read import ComponentSummary, Result
from skymoor.types import Array, Image

SIDE_PX = 480  # of a cut-out of the map
LEAST_PIXELS = 16


@dataclass(frozen=True, eq=False)
class RenderFrame:
    """Where the pixels of a nadir render are in the level frame, whose unit is the flying height.

    `pixel` is its side in level units, `shape` (rows, columns), `reach` the largest distance in level units from the
    middle of the render to something that it shows, and `known` (n, 2) pixels around all that it shows.
    """

    pixel: float
    shape: tuple[int, int]
    reach: float
    known: Array

    def reach_from(self, u: float, v: float) -> float:
        """The largest distance in level units from a pixel to something that the render shows."""
        return float(self.pixel * np.linalg.norm(self.known - [u, v], axis=1).max())


@dataclass(frozen=True)
class Place:
    """A hypothesis of the run: where the middle of the render may lie, how it is turned, and the flying height."""

    score: float
    lat: float
    lon: float
    east: float
    north: float
    azimuth_deg: float
    height_m: float


@dataclass(frozen=True, eq=False)
class Question:
    """A refused component. `render` is None where nothing was rendered; `first_photo` is a photo of it and the
    direction, degrees clockwise from the upper edge of the render, in which it looks, None for runs that did not say.
    """

    component: ComponentSummary
    render: RenderFrame | None
    places: tuple[Place, ...]
    first_photo: tuple[str, float] | None

    @property
    def name(self) -> str:
        """Such as airborne_0."""
        return self.component.name


def questions_of(result: Result) -> list[Question]:
    """One for each component that was refused and can be searched in another area: not ground ones of a model.

    Raises `InputError` where there is none.
    """
    airborne = any(one.image_set == "airborne" for one in result.components)
    refused = [one for one in result.components if not one.registered]
    try:
        asked = [_question(result, one) for one in refused if one.image_set == "airborne" or not airborne]
    except (KeyError, TypeError, ValueError) as error:
        file = result.folder / "summary.json"
        raise InputError(f"{file}: is damaged or of another version ({error!r}); run skymoor run again") from error
    if not asked:
        raise InputError(f"{result.folder}: {_nothing_to_ask(result, refused)}")
    return asked


def question_about(name: str, questions: Sequence[Question]) -> Question:
    """The one about a component. Raises `InputError`."""
    found = next((one for one in questions if one.name == name), None)
    if found is None:
        names = ", ".join(one.name for one in questions)
        raise InputError(f"--component {name}: there is no question about it; give one of {names}")
    return found


def _nothing_to_ask(result: Result, refused: list[ComponentSummary]) -> str:
    if refused:
        return (
            "the airborne components are registered, and ground photos are placed on them: there is nothing to ask; "
            "report.html has the remedies"
        )
    if any(not one["components"] for one in result.summary["sets"]):
        return "nothing was reconstructed, so no place can be asked for; report.html has the remedy"
    return "everything is registered: there is nothing to ask"


def _question(result: Result, component: ComponentSummary) -> Question:
    first = component.summary.get("first_photo")
    return Question(
        component,
        _render_frame(result.folder / "renders" / f"{component.name}_nadir.npz"),
        tuple(_place(one) for one in component.summary.get("hypotheses", [])),
        None if first is None else (str(first["image"]), float(first["azimuth_deg"])),
    )


def _place(one: dict[str, Any]) -> Place:
    names = ("score", "lat", "lon", "east", "north", "azimuth_deg", "metres_per_unit")
    return Place(*(float(one[name]) for name in names))


def _render_frame(file: Path) -> RenderFrame | None:
    try:
        (kept,) = arrays_of(file, ["xyz"])
        xyz = np.asarray(kept, dtype=np.float64).reshape(*kept.shape[:2], 3)
    except (OSError, ValueError, TypeError):
        return None
    rows, columns = np.nonzero(np.isfinite(xyz).all(axis=-1))
    if len(rows) < LEAST_PIXELS or np.ptp(columns) == 0:
        return None
    # x of the level frame grows with the columns, one pixel at a time.
    pixel = float(np.polyfit(columns + 0.5, xyz[rows, columns, 0], 1)[0])
    known = cv2.convexHull(np.column_stack([columns, rows]).astype(np.float32))[:, 0].astype(np.float64) + 0.5
    shape = (int(xyz.shape[0]), int(xyz.shape[1]))
    middle = np.array(shape[::-1]) / 2
    return RenderFrame(pixel, shape, float(pixel * np.linalg.norm(known - middle, axis=1).max()), known)


def cut_out(result: Result, render: RenderFrame, place: Place) -> Image | None:
    """The map as the render would show it at a place: the same extent and azimuth. None where it cannot be read."""
    rows, columns = render.shape
    step = max(1.0, max(rows, columns) / SIDE_PX)  # pixels of the render in one of the cut-out
    size = (max(1, round(columns / step)), max(1, round(rows / step)))
    side_m = step * render.pixel * place.height_m
    u, v = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    x, y = (u - size[0] / 2) * side_m, (size[1] / 2 - v) * side_m
    turn = np.radians(place.azimuth_deg)  # clockwise, from the level frame to the map
    east = place.east + x * np.cos(turn) + y * np.sin(turn)
    north = place.north - x * np.sin(turn) + y * np.cos(turn)
    bounds = [east.min() - side_m, north.min() - side_m, east.max() + side_m, north.max() + side_m]
    try:
        ortho = Path(result.summary["reference"]["ortho"])
        grid, rgb, _, _ = read_part(ortho, None, None, result.frame, bounds, side_m)
    except (InputError, KeyError):
        return None
    px = grid.px_from_enu(np.stack([east, north], axis=-1)) - 0.5
    warped = cv2.remap(rgb, px.astype(np.float32), None, cv2.INTER_LINEAR)
    return np.asarray(warped, np.uint8)
