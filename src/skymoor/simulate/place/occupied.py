# SPDX-License-Identifier: Apache-2.0
"""What is taken, so that nothing stands on another."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.plan import Array

CELL_M = 0.5


class Occupied:
    """A raster of what is taken."""

    def __init__(self, extent_m: float) -> None:
        self._extent = extent_m
        side = int(2 * extent_m / CELL_M)
        self._mask = np.zeros((side, side), dtype=np.uint8)

    def free(self, outline: ArrayLike) -> bool:
        """Whether nothing stands on a polygon (k, 2), and all of it lies in the raster."""
        px = self._px(outline)
        low, high = px.min(axis=0), px.max(axis=0) + 1
        if (low < 0).any() or (high > self._mask.shape[0]).any():
            return False
        window = self._mask[low[1] : high[1], low[0] : high[0]]
        wanted = cv2.fillPoly(np.zeros_like(window), [px - low], 1)
        return not np.any(window & wanted)

    def take(self, outline: ArrayLike) -> None:
        """Mark a polygon (k, 2)."""
        cv2.fillPoly(self._mask, [self._px(outline)], 1)

    def take_line(self, line: ArrayLike, width_m: float) -> None:
        """Mark a polyline (k, 2)."""
        cv2.polylines(self._mask, [self._px(line)], isClosed=False, color=1, thickness=max(int(width_m / CELL_M), 1))

    def _px(self, plan: ArrayLike) -> np.ndarray:
        xy = np.asarray(plan, dtype=np.float64)
        return np.asarray(np.floor((xy + self._extent) / CELL_M), dtype=np.int32)


def grown(outline: ArrayLike, margin_m: float) -> Array:
    """The box around an outline (k, 2) about the origin, `margin_m` wider on all sides."""
    points = np.asarray(outline, dtype=np.float64)
    (x0, y0), (x1, y1) = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def placed(outline: ArrayLike, east: float, north: float, heading_deg: float) -> Array:
    """An outline (k, 2) turned and moved."""
    c, s = np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))
    result: Array = np.asarray(outline, np.float64) @ [[c, s], [-s, c]] + [east, north]
    return result
