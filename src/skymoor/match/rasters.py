# SPDX-License-Identifier: Apache-2.0
"""The nadir render and the reference as input of matchers."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Mask, Raster, Reference, Render

FLAT_M = 0.05
BORDER_PX = 4  # key points closer to the mask's border respond to the border itself


def well_inside(px: Array, mask: Mask) -> NDArray[np.intp]:
    """Which pixels (n, 2) lie on the mask and not beside its border; that of the image does not count as one."""
    side = 2 * BORDER_PX + 1
    inner = cv2.erode(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    h, w = mask.shape
    column, row = np.clip(px.astype(np.intp), 0, [w - 1, h - 1]).T
    return np.flatnonzero(inner[row, column])


def nadir_raster(render: Render, min_confidence: float = 0.3) -> Raster:
    """The render with heights in units of its pixel, NaN where their confidence (0 to 1) is below `min_confidence`."""
    heights = render.xyz[..., 2] / np.float32(render.view.pixel)
    confident = render.confidence >= min_confidence
    return Raster(render.rgb, np.isfinite(heights), np.where(confident, heights, np.nan).astype(np.float32))


def reference_raster(reference: Reference) -> Raster:
    """The reference with heights in units of its pixel; without heights where they are flat, which contradicts all."""
    known = reference.height[np.isfinite(reference.height)]
    if not known.size or float(np.ptp(np.percentile(known, [1, 99]))) < FLAT_M:
        return Raster(reference.rgb, reference.mask)
    return Raster(reference.rgb, reference.mask, (reference.height / reference.grid.pixel_m).astype(np.float32))
