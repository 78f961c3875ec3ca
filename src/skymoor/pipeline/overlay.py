# SPDX-License-Identifier: Apache-2.0
"""The registered nadir render on the grid of the reference."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.geometry import Similarity
from skymoor.match.align import warp_raster
from skymoor.match.rasters import nadir_raster
from skymoor.types import Array, Array32, Raster, Reference, Render


def warp_to_reference(
    render: Render, enu_from_level: Similarity, reference: Reference, min_confidence: float
) -> tuple[Raster, Array32]:
    """The registered nadir render on the reference's grid, and its confident heights, ENU up in metres."""
    b_from_a = reference_from_render(render, enu_from_level, reference)
    # `warp_raster` keeps heights in pixels: give it metres in pixels of the render, and it returns them in the grid's.
    metres_per_px = enu_from_level.scale * render.view.pixel
    up = enu_from_level.apply(render.xyz.astype(np.float64))[..., 2] / metres_per_px
    raster = nadir_raster(render, min_confidence)
    known = raster.height is not None and np.isfinite(raster.height)
    raster = Raster(raster.rgb, raster.mask, np.where(known, up, np.nan).astype(np.float32))
    height, width = reference.grid.shape
    warped = warp_raster(raster, b_from_a, (width, height))
    assert warped.height is not None
    return warped, np.asarray(warped.height * np.float32(reference.grid.pixel_m), dtype=np.float32)


def reference_from_render(render: Render, enu_from_level: Similarity, reference: Reference) -> Array:
    """(2, 3) affine from the render's pixels to the reference's, at ground level."""
    corners = np.array([[0.0, 0.0], [render.view.shape[1], 0.0], [0.0, render.view.shape[0]]])
    view = np.column_stack([[render.view.x0, render.view.y0] + corners * render.view.pixel, np.zeros(3)])
    level = view @ render.view.view_from_level
    px = reference.grid.px_from_enu(enu_from_level.apply(level)[:, :2])
    return np.asarray(cv2.getAffineTransform(corners.astype(np.float32), px.astype(np.float32)))
