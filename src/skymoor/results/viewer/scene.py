# SPDX-License-Identifier: Apache-2.0
"""What there is to see of a run: arrays in metres east, north and up, which know no viewer."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan

import numpy as np
import pycolmap
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import Grid
from skymoor.results.formats import read_pointcloud
from skymoor.results.mosaic import mosaic_of
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.tables import CameraRow
from skymoor.types import Array, Array32, Image

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


def scene_of(result: Result) -> Scene:
    """Everything of a run that can be seen. Raises `InputError` where nothing of it is on Earth."""
    mosaic = mosaic_of(result, MAX_VERTICES)
    notes = [mosaic.note] if mosaic.note else []
    layers = []
    for name, rgb, height in (
        ("satellite", mosaic.satellite, mosaic.satellite_height),
        ("model surface", mosaic.model, mosaic.model_height),
    ):
        if mosaic.grid is not None and rgb is not None and height is not None and np.isfinite(height).any():
            layers.append(draped(name, mosaic.grid, rgb, height))
    cloud = result.folder / "pointcloud.laz"
    if cloud.is_file():
        try:
            layers.append(Layer("point cloud", *read_pointcloud(cloud, result.frame, MAX_POINTS)))
        except InputError as error:
            notes.append(str(error))
    cameras = {}
    for one in (component for component in result.components if component.registered):
        model = _model(result, one)
        if model is not None:
            layers.append(_sparse(one, model))
        cameras[one.name] = _frustums(result, one, model)
        if cameras[one.name]:
            notes += _without_photos(result, cameras[one.name][0])
    if not layers and not any(cameras.values()):
        raise InputError(
            f"{result.folder}: nothing of this run is registered, so there is nothing to show; read report.html"
        )
    return Scene(tuple(layers), cameras, tuple(notes))


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
