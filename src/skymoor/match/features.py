# SPDX-License-Identifier: Apache-2.0
"""Local features of rasters of any size, and their nearest neighbours (Lowe 2004; RootSIFT: Arandjelovic 2012)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Array32, Image, Mask, Raster

TILE_PX, MARGIN_PX = 1024, 48
TILE_FEATURES = 3000  # strongest of a tile
CONTRAST = 0.01  # lawns and roofs have few features above OpenCV's 0.04
BLOCK = 2048  # features that are compared at once: what fits into the processor's cache


@dataclass(frozen=True, eq=False)
class Features:
    """`px` (n, 2) with the first pixel's centre at (0.5, 0.5), `size` (n,) in pixels, `angle` (n,) in radians from u
    towards v, and unit `descriptors` (n, 128) as multiples of 1/255. `pixel` is the side of the pixels in which they
    were found: less than 1 where the raster is kept coarser than that.
    """

    px: Array
    size: Array
    angle: Array
    descriptors: NDArray[np.uint8]
    pixel: float = 1.0

    def __len__(self) -> int:
        return len(self.px)

    @classmethod
    def none(cls) -> Features:
        """Without any."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), np.uint8))

    @classmethod
    def joined(cls, parts: list[Features]) -> Features:
        """All of several."""
        return cls(
            np.concatenate([part.px for part in parts]),
            np.concatenate([part.size for part in parts]),
            np.concatenate([part.angle for part in parts]),
            np.concatenate([part.descriptors for part in parts]),
        )


def features_of(raster: Raster) -> Features:
    """SIFT features of a raster, evenly over it: the strongest of each tile."""
    found = tiles(raster.mask.shape)
    windows = ((np.ascontiguousarray(raster.rgb[one.window]), raster.mask[one.window]) for one in found)
    return Features.joined([tile_features(*window, one) for window, one in zip(windows, found, strict=True)])


@dataclass(frozen=True)
class Tile:
    """Part of a raster, in its pixels: features have their centres in `rows` and `columns`; `window` has a margin for
    what their descriptors see, from the pixel `origin` (u, v) on.
    """

    rows: slice
    columns: slice
    window: tuple[slice, slice]

    @property
    def origin(self) -> tuple[int, int]:
        return self.window[1].start, self.window[0].start


def tiles(shape: tuple[int, ...]) -> list[Tile]:
    """The tiles of a raster of `shape` (h, w)."""
    return [_tile(top, left, shape) for top in range(0, shape[0], TILE_PX) for left in range(0, shape[1], TILE_PX)]


def _tile(top: int, left: int, shape: tuple[int, ...]) -> Tile:
    corners, inner, outer = (top, left), [], []
    for first, side in zip(corners, shape, strict=False):
        inner.append(slice(first, min(first + TILE_PX, side)))
        outer.append(slice(max(0, first - MARGIN_PX), min(first + TILE_PX + MARGIN_PX, side)))
    return Tile(inner[0], inner[1], (outer[0], outer[1]))


def tile_features(rgb: Image, mask: Mask, tile: Tile) -> Features:
    """Features of a tile in pixels of the whole raster, from colours and mask of the tile's window."""
    grey, known = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), mask.astype(np.uint8)
    (left, top), rows, columns = tile.origin, tile.rows, tile.columns
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
        return Features.none()
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    return Features(
        np.array([point.pt for point in kept]) + [left + 0.5, top + 0.5],
        np.array([point.size for point in kept]),
        np.radians([point.angle for point in kept]),
        np.rint(255 * root).astype(np.uint8),
    )


def nearest(a: Features, b: Features, count: int) -> NDArray[np.int64]:
    """The `count` features of b that are most alike each of a, (len(a), count), the nearest first."""
    own, rows = a.descriptors.astype(np.float32), np.arange(len(a))
    best = np.full((len(a), count), -1.0, np.float32)
    index = np.zeros((len(a), count), np.int64)
    for start in range(0, len(b), BLOCK):
        alike: Array32 = own @ b.descriptors[start : start + BLOCK].astype(np.float32).T
        # A few passes for the largest are much cheaper than a partition; most blocks have none that counts.
        for _ in range(min(count, alike.shape[1])):
            place = alike.argmax(axis=1)
            value = alike[rows, place]
            better = np.flatnonzero(value > best[:, -1])
            if not len(better):
                break
            values = np.column_stack([best[better], value[better]])
            places = np.column_stack([index[better], place[better] + start])
            order = np.argsort(-values, axis=1, kind="stable")[:, :count]
            best[better] = np.take_along_axis(values, order, axis=1)
            index[better] = np.take_along_axis(places, order, axis=1)
            alike[rows, place] = -1.0
    return index
