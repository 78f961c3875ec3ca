# SPDX-License-Identifier: Apache-2.0
"""Coloured surfaces and clouds, coarse ones first, and their colours by confidence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import Grid
from skymoor.results.read import Result
from skymoor.types import Array, Array32, Image

MAX_POINTS = 400_000
LEVELS = (12_000, 160_000)  # vertices of a surface: one that is there at once, and one as fine as a browser turns well
SATELLITE, MODEL, CLOUD = "satellite", "model surface", "point cloud"
RAMP = cv2.COLORMAP_VIRIDIS
INTERPOLATED = (150, 150, 150)


@dataclass(frozen=True, eq=False)
class Layer:
    """Coloured points, or the triangles between them: `faces` (m, 3) is None for a cloud.

    A layer replaces one of the same name and a lower level. `confidence` (n,) is in percent, 0 where the height was
    interpolated; None where it is not known.
    """

    name: str
    points: Array32
    colours: NDArray[np.uint8]
    faces: NDArray[np.int32] | None = None
    level: int = 0
    confidence: NDArray[np.uint8] | None = None


def surfaces_of(result: Result, level: int) -> Iterator[Layer | str]:
    """Reference and model as surfaces of about as many vertices as the level has, and lines on what is missing."""
    from skymoor.results.mosaic import confidence_on, mosaic_of

    mosaic = mosaic_of(result, LEVELS[level])
    if mosaic.note and level == 0:
        yield mosaic.note
    if mosaic.grid is None:
        return
    sure = confidence_on(result, mosaic.grid)
    for name, rgb, height, confidence in (
        (SATELLITE, mosaic.satellite, mosaic.satellite_height, None),
        (MODEL, mosaic.model, mosaic.model_height, sure),
    ):
        if rgb is not None and height is not None and np.isfinite(height).any():
            found = draped(name, mosaic.grid, rgb, height)
            known = None if confidence is None else confidence[np.isfinite(height)]
            yield replace(found, level=level, confidence=known)


def cloud_of(result: Result) -> Iterator[Layer | str]:
    """The point cloud with the confidence of the surface where its points are."""
    from skymoor.results.formats import read_pointcloud

    path = result.folder / "pointcloud.laz"
    if not path.is_file():
        return
    try:
        points, colours = read_pointcloud(path, result.frame, MAX_POINTS)
    except InputError as error:
        yield str(error)
        return
    yield Layer(CLOUD, points, colours, confidence=_confidence_at(result, points))


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


def confidence_colours(percent: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours (n, 3) of confidence (n,): viridis from 1 to 100 percent, grey where the height was interpolated."""
    scaled = np.clip(percent.astype(np.float64) * 2.55, 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(scaled[:, None], RAMP)[:, 0, ::-1].copy()
    colours[percent == 0] = INTERPOLATED
    return np.asarray(colours, np.uint8)


def legend_html() -> str:
    """What the colours by confidence mean."""
    stops = confidence_colours(np.array([1, 20, 40, 60, 80, 100], np.uint8))
    ramp = ",".join(f"rgb({r},{g},{b})" for r, g, b in stops.tolist())
    return (
        '<div style="font-size:0.8em;padding:0 1em 0.5em">confidence of heights'
        f'<div style="height:0.8em;margin:0.2em 0;background:linear-gradient(90deg,{ramp})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        "<span>0 %</span><span>50 %</span><span>100 %</span></div>"
        f'<span style="display:inline-block;width:0.8em;height:0.8em;background:rgb{INTERPOLATED}"></span> interpolated'
        "</div>"
    )


def _confidence_at(result: Result, points: Array32) -> NDArray[np.uint8] | None:
    from skymoor.results.mosaic import confidence_on

    if not len(points):
        return None
    low, high = points[:, :2].min(axis=0).astype(np.float64), points[:, :2].max(axis=0).astype(np.float64)
    size: Array = np.maximum(high - low, 1.0)
    pixel = float(np.sqrt(size[0] * size[1] / MAX_POINTS))
    columns, rows = (int(side / pixel) + 1 for side in size.tolist())
    grid = Grid(float(low[0]), float(high[1]), pixel, (rows, columns))
    found = confidence_on(result, grid)
    if found is None:
        return None
    column, row = np.clip(grid.px_from_enu(points[:, :2]).astype(int), 0, [columns - 1, rows - 1]).T
    return np.asarray(found[row, column], np.uint8)
