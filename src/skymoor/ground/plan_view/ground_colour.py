# SPDX-License-Identifier: Apache-2.0
"""The ground before the cameras as an orthophoto, and its agreement with one from above.

Kerbs, paths, lawns and hedges are seen from both sides where facades are not. Colours differ by season, light and
sensor, so what is compared is how they vary: brightness, greenness and hue, each without its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Array32, DepthMap, Image, Mask

Whole = NDArray[np.signedinteger[Any]]

NEAR, FAR = 4.0, 9.0  # camera heights: ground up to NEAR is taken for seen, up to FAR only where space is free
HIDDEN = 0.85  # of a point's depth: what is nearer than that hides it
DARK_GREY = 8.0  # added before the logarithm: noise of dark pixels does not count
CHANNELS = 3
WEIGHTS = np.array([1.0, 1.0, 0.5], np.float32)  # of brightness, greenness, hue
FLOOR = 0.25  # of the orthophoto's spread: variations below it are noise
MOST_POINTS = 800
FEWEST_CELLS = 20
LOCAL_CELLS = 20.0  # standard deviation of the window about which colours vary: as far as the ground is seen


@dataclass(frozen=True, eq=False)
class ColourMap:
    """`channels` (3, h, w) of an orthophoto, where they are `known` (h, w), and their `spread` (3,) over it."""

    channels: Array32
    known: Mask
    spread: Array32

    @cached_property
    def local(self) -> Array32:
        """Channels (3, h, w) less their mean about a cell, over their spread there; 0 where they are unknown."""
        weight = self.known.astype(np.float32)
        total = np.maximum(_window(weight), 1e-3)
        filled = np.where(self.known, self.channels, 0)
        means = np.stack([_window(one) / total for one in filled])
        squares = np.stack([_window(one**2) / total for one in filled])
        spread = np.sqrt(np.maximum(squares - means**2, 0) + (FLOOR * self.spread[:, None, None]) ** 2)
        return np.where(self.known, (filled - means) / spread, 0).astype(np.float32)

    def halved(self) -> ColourMap:
        """The map with cells twice as large."""
        channels = np.stack([halved(one) for one in np.where(self.known, self.channels, 0)])
        share = halved(self.known.astype(np.float32))
        known = share >= 0.5
        return ColourMap(np.where(known, channels / np.maximum(share, 0.25), 0), known, self.spread)

    @cached_property
    def padded(self) -> Array32:
        """Channels less their means, and 1 where they are known (4, (h + 2) (w + 2)); 0 elsewhere and on a border."""
        known = self.known.astype(np.float32)
        means = [one[self.known].mean() if self.known.any() else 0.0 for one in self.channels]
        layers = [np.where(self.known, one - mean, 0) for one, mean in zip(self.channels, means, strict=True)]
        return np.pad([*layers, known], ((0, 0), (1, 1), (1, 1))).reshape(CHANNELS + 1, -1).astype(np.float32)


def halved(values: Array32) -> Array32:
    """Means of blocks of two by two cells; of a border of odd size the last cells are repeated."""
    rows, columns = values.shape
    padded = np.pad(values, ((0, rows % 2), (0, columns % 2)), mode="edge")
    return np.asarray(padded.reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).mean(axis=(1, 3)), dtype=np.float32)


def _window(values: Array32) -> Array32:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), LOCAL_CELLS), dtype=np.float32)


def colour_map(rgb: Image, known: Mask) -> ColourMap:
    """The map of an orthophoto (h, w, 3)."""
    channels = colour_channels(rgb)
    if not known.any():
        return ColourMap(channels, known, np.ones(CHANNELS, np.float32))
    middle = np.median(channels[:, known], axis=1)
    spread = 1.4826 * np.median(np.abs(channels[:, known] - middle[:, None]), axis=1)
    return ColourMap(channels, known, np.maximum(spread, 1e-3).astype(np.float32))


def colour_channels(rgb: Image) -> Array32:
    """Brightness, greenness and hue (3, h, w): logarithms, so that light and gain are constants."""
    red, green, blue = np.log(np.moveaxis(rgb.astype(np.float32), -1, 0) + np.float32(DARK_GREY))
    return np.stack([(red + green + blue) / 3, 2 * green - red - blue, blue - red]).astype(np.float32)


def ground_picture(maps_level: Sequence[DepthMap], free: Array32, pixel: float, centre: Array) -> tuple[Image, Mask]:
    """The plane z = 0 of a level frame as its photos show it: colours (side, side, 3), and where they are seen.

    Args:
        maps_level: depth maps with z up, the ground at 0.
        free: (side, side) free space, rows going down in y.
        pixel, centre: of that raster, in level units.
    """
    side = free.shape[0]
    along = (np.arange(side) + 0.5 - side / 2) * pixel
    x, y = np.meshgrid(centre[0] + along, centre[1] - along)
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(side**2)])
    nearest, rgb = np.full(side**2, np.inf), np.zeros((side**2, 3), np.uint8)
    for one in maps_level:
        distance = np.linalg.norm(ground[:, :2] - one.camera.centre[:2], axis=1)
        chosen = np.flatnonzero(distance < np.minimum(nearest, FAR))
        colours, seen = _seen(one, ground[chosen])
        nearest[chosen[seen]], rgb[chosen[seen]] = distance[chosen[seen]], colours[seen]
    shown = np.isfinite(nearest) & ((free.ravel() > 0) | (nearest < NEAR))
    return rgb.reshape(side, side, 3), shown.reshape(side, side)


def _seen(one: DepthMap, points: Array) -> tuple[Image, Mask]:
    """Colours (n, 3) of points of the ground in a photo, and which of them are in it and not hidden."""
    height, width = one.depth.shape
    in_camera = one.camera.cam_from_world.apply(points)
    before = in_camera[:, 2] > 1e-3
    px = np.full((len(points), 2), -1.0)
    px[before] = one.camera.intrinsics.px_from_cam(in_camera[before])
    inside = (px >= 0).all(axis=1) & (px < [width, height]).all(axis=1)
    u, v = (np.where(inside, px[:, k], 0).astype(np.int64) for k in (0, 1))
    hidden = one.depth[v, u] < HIDDEN * in_camera[:, 2]  # False where the depth is unknown
    return one.rgb[v, u], inside & ~hidden


def moved_cells(cells: Whole, moves: Whole, shape: tuple[int, ...]) -> Whole:
    """Cells (n, 2), u and v, moved by (k, 2): flat elements (k, n) in a layer of that shape with a border of one cell.

    All that is beyond the layer is on its border.
    """
    (columns, of_u), (rows, of_v) = (np.unique(moves[:, axis], return_inverse=True) for axis in (0, 1))
    u, v = cells[:, 0] + columns[:, None] + 1, cells[:, 1] + rows[:, None] + 1
    u, v = np.clip(u, 0, shape[1] + 1), np.clip(v, 0, shape[0] + 1) * (shape[1] + 2)
    return np.asarray(u[of_u] + v[of_v])


@dataclass(frozen=True, eq=False)
class GroundCells:
    """Cells of a turned and scaled ground picture: `offsets` (n, 2) in cells from its corner, `channels` (3, n)."""

    offsets: Whole
    channels: Array32

    def layers(self, size: int) -> Array32:
        """The cells as rasters (3, size, size) without their means, weighted, whose correlation is an agreement."""
        rasters = np.zeros((CHANNELS, size, size), np.float32)
        if len(self.offsets) >= FEWEST_CELLS:
            varied = self.channels - self.channels.mean(axis=1, keepdims=True)
            varied *= WEIGHTS[:, None] / np.maximum(varied.std(axis=1, keepdims=True), 1e-3)
            rasters[:, self.offsets[:, 1], self.offsets[:, 0]] = varied / len(self.offsets)
        return rasters

    def agreement(self, target: ColourMap, corners: Whole) -> Array32:
        """Correlation (k,) with the orthophoto, with the corner at cells (k, 2); NaN where it is hardly known."""
        if self.offsets.shape[0] < FEWEST_CELLS:
            return np.full(len(corners), np.nan, np.float32)
        *others, known = target.padded.take(moved_cells(self.offsets, corners, target.known.shape), axis=1)
        count, theirs = np.maximum(known.sum(axis=1), 1), np.stack(others)
        own = self.channels - self.channels.mean(axis=1, keepdims=True)
        # Moments (3, k) over the cells that are known: `theirs` is zero elsewhere.
        mean_own, mean_theirs = (known @ own.T / count[:, None]).T, theirs.sum(axis=2) / count
        square_own, square_theirs = (known @ (own**2).T / count[:, None]).T, (theirs**2).sum(axis=2) / count
        product = (theirs @ own[..., None])[..., 0] / count
        floor = (FLOOR * target.spread[:, None]) ** 2
        variances = [np.maximum(x, 0) + floor for x in (square_own - mean_own**2, square_theirs - mean_theirs**2)]
        each = (product - mean_own * mean_theirs) / np.sqrt(variances[0] * variances[1])
        found = WEIGHTS @ each / WEIGHTS.sum()
        return np.where(known.mean(axis=1) >= 0.5, found, np.nan).astype(np.float32)


def ground_layers(rgb: Image, seen: Mask) -> Array32:
    """Layers (side, side, 4) of a ground picture: colours where they are seen, and where that is."""
    weight = seen.astype(np.float32)[..., None]
    return np.concatenate([rgb.astype(np.float32) * weight, weight], axis=2)


def ground_cells(smooth: Array32, zoom: float, azimuth_rad: float, size: int) -> GroundCells:
    """A ground picture turned counter-clockwise and scaled by `zoom` about its middle, to that of `size` cells.

    `smooth` is of `smoothed_layers` of `ground_layers`.
    """
    turned = turned_layers(smooth, zoom, azimuth_rad, size)
    v, u = np.nonzero(turned[..., 3] > 0.5)
    if len(u) > MOST_POINTS:
        kept = np.linspace(0, len(u) - 1, MOST_POINTS).astype(np.int64)
        u, v = u[kept], v[kept]
    colours = (turned[v, u, :3] / turned[v, u, 3:]).clip(0, 255)
    return GroundCells(np.column_stack([u, v]), colour_channels(colours[None])[:, 0])


def smoothed_layers(layers: Array32, zoom: float) -> Array32:
    """Layers (side, side, n) blurred so that they may be sampled at a `zoom`."""
    return np.asarray(cv2.GaussianBlur(layers, (0, 0), max(0.5 / zoom, 0.3)), dtype=np.float32)


def turned_layers(smooth: Array32, zoom: float, azimuth_rad: float, size: int) -> Array32:
    """`smoothed_layers` turned counter-clockwise and scaled about their middle, to (size, size, n); 0 beyond."""
    half = smooth.shape[0] / 2
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    # v runs down: counter-clockwise in plan is clockwise in (u, v).
    linear = zoom * np.array([[c, s], [-s, c]])
    offset = size / 2 - linear @ [half, half]
    matrix = np.column_stack([linear, offset + linear @ [0.5, 0.5] - 0.5])
    return np.asarray(cv2.warpAffine(smooth, matrix, (size, size), flags=cv2.INTER_LINEAR), dtype=np.float32)
