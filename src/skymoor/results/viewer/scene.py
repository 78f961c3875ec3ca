# SPDX-License-Identifier: Apache-2.0
"""What there is to see of a run: arrays in metres east, north and up, which know no viewer.

What reads clouds and references is imported when they are: it takes seconds, and the viewer is there before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from math import atan
from typing import TYPE_CHECKING

import numpy as np

from skymoor.errors import InputError
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.tables import CameraRow
from skymoor.results.viewer.splats import Splats, splats_of
from skymoor.results.viewer.surfaces import LEVELS, Layer, cloud_of, surfaces_of
from skymoor.types import Array

if TYPE_CHECKING:
    import pycolmap

FOV_RAD = 1.0  # where the COLMAP model is gone


@dataclass(frozen=True, eq=False)
class Frustum:
    """A camera: its row of cameras.csv, its attitude as viewers want it, and its angle of view from top to bottom."""

    row: CameraRow
    position: Array
    enu_from_camera_wxyz: Array
    fov_rad: float
    aspect: float


Cameras = dict[str, tuple[Frustum, ...]]
Part = Layer | Splats | Cameras | str
"""Of a scene: a layer, splats, the cameras of a component, or a line about what is missing and why."""


def parts_of(result: Result) -> Iterator[Part]:
    """All that can be seen of a run, what takes long to load last: coarse surfaces, cameras, clouds, fine surfaces.

    Raises `InputError` at the end where nothing was on Earth.
    """
    empty = True
    fine = (surfaces_of(result, level) for level in range(1, len(LEVELS)))
    for part in chain(
        surfaces_of(result, 0), _components(result), splats_of(result), cloud_of(result), chain.from_iterable(fine)
    ):
        seen = any(part.values()) if isinstance(part, dict) else not isinstance(part, str)
        empty = empty and not seen
        yield part
    if empty:
        raise InputError(
            f"{result.folder}: nothing of this run is registered, so there is nothing to show; read report.html"
        )


def _components(result: Result) -> Iterator[Part]:
    for one in (component for component in result.components if component.registered):
        model = _model(result, one)
        frustums = _frustums(result, one, model)
        yield {one.name: frustums}
        if frustums:
            yield from _without_photos(result, frustums[0])
        if model is not None:
            yield _sparse(one, model)


def _model(result: Result, component: ComponentSummary) -> pycolmap.Reconstruction | None:
    try:
        return result.model(component)
    except InputError:  # the rest can still be seen
        return None


def _without_photos(result: Result, first: Frustum) -> list[str]:
    try:
        result.photo(first.row.image)
    except InputError as error:  # cameras are seen as they are, and one looks to see whether the folder has moved
        return [str(error)]
    return []


def _sparse(component: ComponentSummary, model: pycolmap.Reconstruction) -> Layer:
    points = list(model.points3D.values())
    xyz = np.array([point.xyz for point in points], dtype=np.float32).reshape(-1, 3)
    colours = np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3)
    return Layer(f"tie points {component.name}", xyz, colours)


def _frustums(
    result: Result, component: ComponentSummary, model: pycolmap.Reconstruction | None
) -> tuple[Frustum, ...]:
    lenses = {} if model is None else {image.name: image.camera for image in model.images.values()}
    found = []
    for row in result.cameras:
        turn = (row.qw, row.qx, row.qy, row.qz)
        position = (row.east, row.north, row.up)
        if (row.set, row.component) != (component.image_set, component.index) or None in (*turn, *position):
            continue
        lens = lenses.get(row.image)
        fov = FOV_RAD if lens is None else 2 * atan(0.5 * lens.height / lens.focal_length_y)
        aspect = 4 / 3 if lens is None else lens.width / lens.height
        # The table has camera-from-ENU; the inverse of a unit quaternion is its conjugate.
        turned = np.array(turn, dtype=np.float64) * [1, -1, -1, -1]
        found.append(Frustum(row, np.array(position, dtype=np.float64), turned, fov, aspect))
    return tuple(found)
