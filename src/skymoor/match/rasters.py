# SPDX-License-Identifier: Apache-2.0
"""The nadir render and the reference as input of matchers."""

from __future__ import annotations

import numpy as np

from skymoor.types import Raster, Reference, Render

FLAT_M = 0.05


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
