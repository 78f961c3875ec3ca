# SPDX-License-Identifier: Apache-2.0
"""The default matcher, without learned weights: block matching of structural channels."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.match.channels import ChannelOptions, Channels, make_channels
from skymoor.match.protocol import DenseMatcher
from skymoor.types import Array32, Raster, Warp

GROUPS = (slice(0, 4), slice(4, 6))  # colour and height channels, which have separate masks


@dataclass(frozen=True)
class StructuralMatcher:
    """Block matching of structural channels within `reach_px` of the identity, in both directions, to subpixels.

    The images must be aligned up to `reach_px`. One cost volume serves both directions, so that the subsequent cyclic
    test is the left-right check of stereo matching.

    Attributes:
        reach_px: search radius: the largest displacement, in pixels.
        window_px: Gaussian sigma of the matching window, in pixels.
        grid_px: spacing of the grid on which the flow is estimated; it is interpolated in between.
        margin: lead of the best correlation over the best elsewhere that gives full confidence.
        channels: how structural channels are made.
    """

    reach_px: int = 8
    window_px: float = 7.0
    grid_px: int = 4
    margin: float = 0.1
    channels: ChannelOptions = field(default_factory=ChannelOptions)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match in both directions; see `DenseMatcher`."""
        if a.mask.shape != b.mask.shape:
            raise ValueError(
                f"the structural matcher needs images of equal size, not {a.mask.shape} and {b.mask.shape}"
            )
        forward, backward = self._costs(make_channels(a, self.channels), make_channels(b, self.channels))
        flow_a, confidence_a = self._flow(forward, a.mask.shape)
        flow_b, confidence_b = self._flow(backward, b.mask.shape)
        # Windows extend beyond the masks; matches found there are discarded.
        return Warp(flow_a, confidence_a * a.mask, flow_b, confidence_b * b.mask)

    def _costs(self, a: Channels, b: Channels) -> tuple[Array32, Array32]:
        """Correlation of each grid pixel at each displacement, (h/g, w/g, side, side): of a in b, and of b in a."""
        r, g = self.reach_px, self.grid_px
        side = 2 * r + 1
        h, w = a.values.shape[1:]
        grid = np.arange(g // 2, h, g), np.arange(g // 2, w, g)
        forward = np.empty((len(grid[0]), len(grid[1]), side, side), np.float32)
        backward = np.empty_like(forward)
        padded_values = np.pad(b.values, ((0, 0), (r, r), (r, r)))
        padded_known = np.pad(b.known, ((0, 0), (r, r), (r, r)))
        rows, columns = np.meshgrid(*grid, indexing="ij")
        for dv in range(-r, r + 1):
            for du in range(-r, r + 1):
                window = (slice(None), slice(r + dv, r + dv + h), slice(r + du, r + du + w))
                correlation = self._correlation(a, padded_values[window], padded_known[window])
                forward[..., r + dv, r + du] = correlation[rows, columns]
                # If pixel x of a matches y of b by (du, dv), then y matches x by (-du, -dv).
                back_rows, back_columns = np.clip(rows - dv, 0, h - 1), np.clip(columns - du, 0, w - 1)
                backward[..., r - dv, r - du] = correlation[back_rows, back_columns]
        return forward, backward

    def _correlation(self, a: Channels, b_values: Array32, b_known: Array32) -> Array32:
        """NCC in a Gaussian window, over pixels valid in both images, at one displacement."""
        numerator = np.zeros(a.values.shape[1:], np.float32)
        energy_a, energy_b = np.zeros_like(numerator), np.zeros_like(numerator)
        for k, group in enumerate(GROUPS):
            fa, fb = a.values[group], b_values[group]
            numerator += np.einsum("chw,chw->hw", fa, fb)
            energy_a += np.einsum("chw,chw->hw", fa, fa) * b_known[k]
            energy_b += np.einsum("chw,chw->hw", fb, fb) * a.known[k]
        stack = [self._pool(x) for x in (numerator, energy_a, energy_b)]
        # The floor prevents high scores in featureless windows, where both energies are noise.
        return np.asarray(stack[0] / (np.sqrt(np.maximum(stack[1] * stack[2], 0)) + 0.02), dtype=np.float32)

    def _pool(self, values: Array32) -> Array32:
        width = 2 * round(self.window_px * 1.22) + 1  # two box filters have about this Gaussian's variance
        once = cv2.blur(values, (width, width), borderType=cv2.BORDER_CONSTANT)
        return np.asarray(cv2.blur(once, (width, width), borderType=cv2.BORDER_CONSTANT), dtype=np.float32)

    def _flow(self, cost: Array32, shape: tuple[int, int]) -> tuple[Array32, Array32]:
        """Pixel of the other image (h, w, 2) and confidence (h, w) in [0, 1], from one direction's correlations."""
        rows, columns, side, _ = cost.shape
        r, g = self.reach_px, self.grid_px
        flat = cost.reshape(rows, columns, -1)
        best = flat.argmax(axis=-1)
        dv, du = np.divmod(best, side)
        value = np.take_along_axis(flat, best[..., None], axis=-1)[..., 0]
        second = _second_best(cost, dv, du)
        inner = (dv > 0) & (du > 0) & (dv < side - 1) & (du < side - 1)
        fv, fu = _subpixel(cost, dv, du)
        v0, u0 = np.meshgrid(np.arange(rows) * g + g // 2 + 0.5, np.arange(columns) * g + g // 2 + 0.5, indexing="ij")
        flow = np.stack([u0 + du - r + fu, v0 + dv - r + fv], axis=-1).astype(np.float32)
        confidence = np.clip(value, 0, 1) * np.clip((value - second) / self.margin, 0, 1) * inner
        return _upsample(flow, g, shape), _upsample(confidence.astype(np.float32), g, shape)


_: type[DenseMatcher] = StructuralMatcher


def _second_best(cost: Array32, dv: NDArray[np.intp], du: NDArray[np.intp], apart: int = 3) -> Array32:
    """The best correlation at least `apart` pixels away from the best."""
    side = cost.shape[-1]
    steps = np.arange(side)
    near_v = np.abs(steps - dv[..., None]) < apart
    near_u = np.abs(steps - du[..., None]) < apart
    masked = np.where(near_v[..., :, None] & near_u[..., None, :], -np.inf, cost)
    return np.asarray(masked.max(axis=(-2, -1)), dtype=np.float32)


def _subpixel(cost: Array32, dv: NDArray[np.intp], du: NDArray[np.intp]) -> tuple[Array32, Array32]:
    """Vertices of the parabolas through the best and its neighbours, along v and u, in pixels."""
    side = cost.shape[-1]
    v, u = np.clip(dv, 1, side - 2), np.clip(du, 1, side - 2)
    i, j = np.indices(v.shape)
    middle = cost[i, j, v, u]

    def vertex(low: Array32, high: Array32) -> Array32:
        curvature = np.minimum(low - 2 * middle + high, -1e-6)
        return np.asarray(np.clip(0.5 * (low - high) / curvature, -0.5, 0.5), dtype=np.float32)

    return vertex(cost[i, j, v - 1, u], cost[i, j, v + 1, u]), vertex(cost[i, j, v, u - 1], cost[i, j, v, u + 1])


def _upsample(values: Array32, grid: int, shape: tuple[int, int]) -> Array32:
    """From every `grid`-th pixel (the first at grid // 2) to every pixel, linearly."""
    h, w = shape
    u = ((np.arange(w) - grid // 2) / grid).astype(np.float32)
    v = ((np.arange(h) - grid // 2) / grid).astype(np.float32)
    map_u, map_v = np.meshgrid(u, v)
    # Beyond the last grid pixel, displacements are replicated instead of extrapolated.
    clipped_u, clipped_v = np.clip(map_u, 0, values.shape[1] - 1), np.clip(map_v, 0, values.shape[0] - 1)
    full = cv2.remap(values, clipped_u, clipped_v, cv2.INTER_LINEAR)
    if full.ndim == 3:
        full = full + grid * np.stack([map_u - clipped_u, map_v - clipped_v], axis=-1)
    return np.asarray(full, dtype=np.float32)
