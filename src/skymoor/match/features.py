# SPDX-License-Identifier: Apache-2.0
"""Local features of rasters of any size, and their nearest neighbours (Lowe 2004; RootSIFT: Arandjelovic 2012)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Array32, Image, Mask, Raster

TILE_PX, MARGIN_PX = 1024, 48
TILE_FEATURES = 3000  # strongest of a tile
CONTRAST = 0.01  # lawns and roofs have few features above OpenCV's 0.04
BLOCK = 65536  # features that are compared at once: bounds the memory


@dataclass(frozen=True, eq=False)
class Features:
    """`px` (n, 2) with the first pixel's centre at (0.5, 0.5), `size` (n,) in pixels, `angle` (n,) in radians from u
    towards v, and unit `descriptors` (n, 128) as multiples of 1/255.
    """

    px: Array
    size: Array
    angle: Array
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.px)

    @classmethod
    def joined(cls, parts: list[Features]) -> Features:
        """All of several."""
        names = ("px", "size", "angle", "descriptors")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def features_of(raster: Raster) -> Features:
    """SIFT features of a raster, evenly over it: the strongest of each tile."""
    parts = [_of_tile(raster.rgb, raster.mask, rows, columns) for rows, columns in _tiles(raster.mask.shape)]
    return Features.joined(parts)


def _tiles(shape: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    for top in range(0, shape[0], TILE_PX):
        for left in range(0, shape[1], TILE_PX):
            yield slice(top, min(top + TILE_PX, shape[0])), slice(left, min(left + TILE_PX, shape[1]))


def _of_tile(rgb: Image, mask: Mask, rows: slice, columns: slice) -> Features:
    """Features with their centres in a tile; the margin around it is seen by their windows."""
    top, left = max(0, rows.start - MARGIN_PX), max(0, columns.start - MARGIN_PX)
    window = np.s_[top : rows.stop + MARGIN_PX, left : columns.stop + MARGIN_PX]
    grey, known = cv2.cvtColor(np.ascontiguousarray(rgb[window]), cv2.COLOR_RGB2GRAY), mask[window].astype(np.uint8)
    found: tuple[cv2.KeyPoint, ...] = ()
    if known.any():
        detector = cv2.SIFT.create(contrastThreshold=CONTRAST)
        found = tuple(detector.detect(grey, known))
    px = np.array([point.pt for point in found]).reshape(-1, 2) + [left + 0.5, top + 0.5]
    inside = (px >= [columns.start, rows.start]).all(axis=1) & (px < [columns.stop, rows.stop]).all(axis=1)
    share = (rows.stop - rows.start) * (columns.stop - columns.start) / TILE_PX**2
    strength = np.array([point.response for point in found])
    chosen = np.flatnonzero(inside)
    chosen = chosen[np.argsort(-strength[chosen], kind="stable")[: int(np.ceil(TILE_FEATURES * share))]]
    kept, descriptors = detector.compute(grey, [found[k] for k in chosen]) if len(chosen) else ((), None)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), np.uint8))
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    return Features(
        np.array([point.pt for point in kept]) + [left + 0.5, top + 0.5],
        np.array([point.size for point in kept]),
        np.radians([point.angle for point in kept]),
        np.rint(255 * root).astype(np.uint8),
    )


def nearest(a: Features, b: Features, count: int) -> NDArray[np.int64]:
    """The `count` features of b that are most alike each of a, (len(a), count), the nearest first."""
    own = a.descriptors.astype(np.float32)
    best = np.full((len(a), count), -1.0, np.float32)
    index = np.zeros((len(a), count), np.int64)
    for start in range(0, len(b), BLOCK):
        alike: Array32 = own @ b.descriptors[start : start + BLOCK].astype(np.float32).T
        few = min(count, alike.shape[1])
        block = np.argpartition(-alike, few - 1, axis=1)[:, :few]
        values = np.concatenate([best, np.take_along_axis(alike, block, axis=1)], axis=1)
        places = np.concatenate([index, block + start], axis=1)
        order = np.argsort(-values, axis=1, kind="stable")[:, :count]
        best, index = np.take_along_axis(values, order, axis=1), np.take_along_axis(places, order, axis=1)
    return index
