# SPDX-License-Identifier: Apache-2.0
"""Image pyramid with heights and masks."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.types import Raster


class Pyramid:
    """Reduces a raster from the nearest larger octave, so that many sizes stay cheap."""

    def __init__(self, raster: Raster) -> None:
        self._levels = [raster]

    def at(self, ratio: float) -> Raster:
        """The raster at `ratio` times its size; heights in units of the new pixel."""
        level = self._level(ratio)
        return resize(self._levels[level], ratio * 2**level, self._levels[0], ratio)

    def window(self, ratio: float, u0: float, v0: float, side: int) -> tuple[Raster, float, float]:
        """A part of `at(ratio)` that holds the square of `side` from (u0, v0) on, as far as that is in the raster.

        Returns it with the position (u, v) of its outer corner. Nothing else is resampled: rasters may be large.
        """
        level = self._level(ratio)
        whole, own = self._levels[level], ratio * 2**level
        rows, columns = whole.mask.shape
        left, top = (int(np.clip(np.floor(x / own), 0, n - 1)) for x, n in ((u0, columns), (v0, rows)))
        right, bottom = (int(np.ceil((x + side) / own)) for x in (u0, v0))
        part = np.s_[top : max(bottom, top + 1), left : max(right, left + 1)]
        height = None if whole.height is None else whole.height[part]
        raster = Raster(whole.rgb[part], whole.mask[part], height)
        return resize(raster, own, raster, own), left * own, top * own

    def _level(self, ratio: float) -> int:
        """The octave that is resampled for a ratio."""
        level = 0
        while ratio * 2 ** (level + 1) <= 1:
            level += 1
            if level == len(self._levels):
                self._levels.append(resize(self._levels[-1], 0.5, self._levels[0], 0.5**level))
        return level


def resize(raster: Raster, ratio: float, original: Raster, overall: float) -> Raster:
    """Resample by averaging; heights stay in units of the pixel. The new size is `overall` times that of `original`."""
    h, w = original.mask.shape
    size = (max(1, round(w * overall)), max(1, round(h * overall)))
    if size == raster.mask.shape[::-1]:
        return raster
    interpolation = cv2.INTER_AREA if ratio < 1 else cv2.INTER_LINEAR
    mask = cv2.resize(raster.mask.astype(np.float32), size, interpolation=interpolation) > 0.6
    rgb = cv2.resize(raster.rgb, size, interpolation=interpolation)
    height = None
    if raster.height is not None:
        known = np.isfinite(raster.height)
        fraction = cv2.resize(known.astype(np.float32), size, interpolation=interpolation)
        total = cv2.resize(np.where(known, raster.height, 0).astype(np.float32), size, interpolation=interpolation)
        height = np.where(fraction > 0.6, total / np.maximum(fraction, 1e-3) * np.float32(ratio), np.nan).astype(
            np.float32
        )
    return Raster(rgb, mask, height)
