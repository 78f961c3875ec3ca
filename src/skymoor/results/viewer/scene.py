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
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import Grid
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.tables import CameraRow
from skymoor.types import Array, Array32, Image

if TYPE_CHECKING:
    import pycolmap

MAX_POINTS = 400_000
MAX_VERTICES = 160_000
FOV_RAD = 1.0  # where the COLMAP model is gone


@dataclass(frozen=True, eq=False)
class Layer:
    """Coloured points, or the triangles between them: `faces` (m, 3) is None for a cloud."""

    name: str
    points: Array32
    colours: NDArray[np.uint8]
    faces: NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class Frustum:
    """A camera: its row of cameras.csv, its attitude as viewers want it, and its angle of view from top to bottom."""

    row: CameraRow
    position: Array
    enu_from_camera_wxyz: Array
    fov_rad: float
    aspect: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Layers, cameras by their component, and what is missing and why."""

    layers: tuple[Layer, ...]
    cameras: dict[str, tuple[Frustum, ...]]
    notes: tuple[str, ...]


Part = Layer | dict[str, tuple[Frustum, ...]] | str
"""Of a scene: a layer, the cameras of a component, or a line about what is missing and why."""


def scene_of(result: Result) -> Scene:
    """Everything of a run that can be seen. Raises `InputError` where nothing of it is on Earth."""
    parts = list(parts_of(result))
    cameras: dict[str, tuple[Frustum, ...]] = {}
    for part in parts:
        cameras |= part if isinstance(part, dict) else {}
    layers = tuple(part for part in parts if isinstance(part, Layer))
    return Scene(layers, cameras, tuple(part for part in parts if isinstance(part, str)))


def parts_of(result: Result) -> Iterator[Part]:
    """The same one by one, what takes long to load last. Raises `InputError` at the end where there was nothing."""
    empty = True
    for part in chain(_components(result), _cloud(result), _surfaces(result)):
        seen = any(part.values()) if isinstance(part, dict) else isinstance(part, Layer)
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


def _cloud(result: Result) -> Iterator[Part]:
    from skymoor.results.formats import read_pointcloud

    cloud = result.folder / "pointcloud.laz"
    if cloud.is_file():
        try:
            yield Layer("point cloud", *read_pointcloud(cloud, result.frame, MAX_POINTS))
        except InputError as error:
            yield str(error)


def _surfaces(result: Result) -> Iterator[Part]:
    from skymoor.results.mosaic import mosaic_of

    mosaic = mosaic_of(result, MAX_VERTICES)
    if mosaic.note:
        yield mosaic.note
    for name, rgb, height in (
        ("satellite", mosaic.satellite, mosaic.satellite_height),
        ("model surface", mosaic.model, mosaic.model_height),
    ):
        if mosaic.grid is not None and rgb is not None and height is not None and np.isfinite(height).any():
            yield draped(name, mosaic.grid, rgb, height)


def draped(name: str, grid: Grid, rgb: Image, height: Array32) -> Layer:
    """Colours (h, w, 3) on the surface of heights (h, w); there is no triangle where a corner is unknown."""
    known = np.isfinite(height)
    number = np.cumsum(known.ravel()).reshape(known.shape) - 1
    points = np.concatenate([grid.centres(), height[..., None]], axis=-1)[known].astype(np.float32)
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    whole = known[:-1, :-1] & known[1:, :-1] & known[1:, 1:] & known[:-1, 1:]
    square = corners[whole]
    faces = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]]).astype(np.int32)
    return Layer(name, points, rgb[known], faces)


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
