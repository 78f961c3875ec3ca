# SPDX-License-Identifier: Apache-2.0
"""One image at many sizes."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.types import Raster


class Pyramid:
    """Reduces an image from the nearest of its halvings, so that asking for many sizes stays cheap."""

    def __init__(self, raster: Raster) -> None:
        self._levels = [raster]

    def at(self, ratio: float) -> Raster:
        """The image at `ratio` of its size."""
        level = 0
        while ratio * 2 ** (level + 1) <= 1:
            level += 1
            if level == len(self._levels):
                self._levels.append(resize(self._levels[-1], 0.5, self._levels[0], 0.5**level))
        return resize(self._levels[level], ratio * 2**level, self._levels[0], ratio)


def resize(raster: Raster, ratio: float, original: Raster, overall: float) -> Raster:
    """Resample by averaging; heights stay in units of a pixel. The size follows from the `original` one."""
    h, w = original.mask.shape
    size = (max(1, round(w * overall)), max(1, round(h * overall)))
    if size == raster.mask.shape[::-1]:
        return raster
    how = cv2.INTER_AREA if ratio < 1 else cv2.INTER_LINEAR
    mask = cv2.resize(raster.mask.astype(np.float32), size, interpolation=how) > 0.6
    rgb = cv2.resize(raster.rgb, size, interpolation=how)
    height = None
    if raster.height is not None:
        known = np.isfinite(raster.height)
        share = cv2.resize(known.astype(np.float32), size, interpolation=how)
        total = cv2.resize(np.where(known, raster.height, 0).astype(np.float32), size, interpolation=how)
        height = np.where(share > 0.6, total / np.maximum(share, 1e-3) * np.float32(ratio), np.nan).astype(np.float32)
    return Raster(rgb, mask, height)
