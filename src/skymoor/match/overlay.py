# SPDX-License-Identifier: Apache-2.0
"""The registered nadir render on a grid of the map."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.geo import Grid
from skymoor.geometry import Similarity
from skymoor.match.align import warp_raster
from skymoor.match.rasters import nadir_raster
from skymoor.types import Array, Array32, Raster, Render


def warp_to_grid(
    render: Render, enu_from_level: Similarity, grid: Grid, min_confidence: float
) -> tuple[Raster, Array32]:
    """The registered nadir render on a grid, and its confident heights, ENU up in metres."""
    # `warp_raster` keeps heights in pixels: give it metres in pixels of the render, and it returns them in the grid's.
    metres_per_px = enu_from_level.scale * render.view.pixel
    up = enu_from_level.apply(render.xyz.astype(np.float64))[..., 2] / metres_per_px
    raster = nadir_raster(render, min_confidence)
    known = raster.height is not None and np.isfinite(raster.height)
    raster = Raster(raster.rgb, raster.mask, np.where(known, up, np.nan).astype(np.float32))
    height, width = grid.shape
    warped = warp_raster(raster, grid_from_render(render, enu_from_level, grid), (width, height))
    assert warped.height is not None
    return warped, np.asarray(warped.height * np.float32(grid.pixel_m), dtype=np.float32)


def warp_confidence(render: Render, enu_from_level: Similarity, grid: Grid) -> Array32:
    """The render's confidence (h, w), 0 to 1, on a grid; 0 beside it."""
    height, width = grid.shape
    matrix = grid_from_render(render, enu_from_level, grid)
    # OpenCV's origin is the centre of the first pixel, in both images.
    matrix[:, 2] += matrix[:, :2] @ [0.5, 0.5] - 0.5
    return np.asarray(cv2.warpAffine(render.confidence, matrix, (width, height), flags=cv2.INTER_LINEAR), np.float32)


def grid_from_render(render: Render, enu_from_level: Similarity, grid: Grid) -> Array:
    """(2, 3) affine from the render's pixels to those of a grid, at ground level."""
    corners = np.array([[0.0, 0.0], [render.view.shape[1], 0.0], [0.0, render.view.shape[0]]])
    px = grid.px_from_enu(_plan(render, enu_from_level, corners))
    return np.asarray(cv2.getAffineTransform(corners.astype(np.float32), px.astype(np.float32)))


def render_bounds(
    render: Render, enu_from_level: Similarity, min_confidence: float
) -> tuple[float, float, float, float]:
    """West, south, east and north of what the render shows with that confidence, ENU metres at ground level."""
    rows, columns = np.nonzero(np.isfinite(render.xyz[..., 2]) & (render.confidence >= min_confidence))
    if not len(rows):
        rows, columns = np.array([0, render.view.shape[0] - 1]), np.array([0, render.view.shape[1] - 1])
    u, v = ([side.min(), side.max() + 1] for side in (columns, rows))
    plan = _plan(render, enu_from_level, np.array([[x, y] for x in u for y in v], dtype=np.float64))
    (west, south), (east, north) = plan.min(axis=0).tolist(), plan.max(axis=0).tolist()
    return west, south, east, north


def _plan(render: Render, enu_from_level: Similarity, px: Array) -> Array:
    """East and north (n, 2) of pixels (n, 2) of the render, at ground level."""
    view = np.column_stack([[render.view.x0, render.view.y0] + px * render.view.pixel, np.zeros(len(px))])
    return enu_from_level.apply(view @ render.view.view_from_level)[:, :2]
