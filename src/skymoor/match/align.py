# SPDX-License-Identifier: Apache-2.0
"""Lay one image on the other by a hypothesis, match them there, and say the matches in their own pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from skymoor.match.cyclic import CyclicOptions, cyclic_matches
from skymoor.match.protocol import DenseMatcher
from skymoor.match.pyramid import Pyramid
from skymoor.types import Array, Matches2D, Raster, Warp


def match_hypothesis(
    a: Raster,
    b: Raster,
    b_from_a: Array,
    matcher: DenseMatcher,
    options: CyclicOptions | None = None,
    *,
    rng: np.random.Generator,
    margin_px: int = 16,
) -> tuple[Matches2D, Warp]:
    """Cyclically consistent matches of `a` in `b`, given about where it lies.

    Args:
        a, b: the images.
        b_from_a: (2, 3) affine between their pixels: a similarity, from a search or a former registration.
        matcher: compares `a`, resampled to the pixels of b, with the part of b that it covers.
        options: thresholds; pixels are those of b.
        rng: for the random choice among many matches.
        margin_px: border around the covered part.

    Returns:
        matches in pixels of a and of b, and the warp between the two laid images.
    """
    u0, v0, width, height = _covered(a, b, b_from_a, margin_px)
    shift = np.array([[1, 0, -u0], [0, 1, -v0]], dtype=np.float64)
    laid = _compose(shift, b_from_a)
    warp = matcher(lay(a, laid, (width, height)), _crop(b, u0, v0, width, height))
    found = cyclic_matches(warp, options, rng=rng)
    back = cv2.invertAffineTransform(laid)
    px_a = found.px_a @ back[:, :2].T + back[:, 2]
    return replace(found, px_a=px_a, px_b=found.px_b + [u0, v0]), warp


def lay(a: Raster, b_from_a: Array, size: tuple[int, int]) -> Raster:
    """`a` resampled by a similarity to `size` (width, height); reduced by averaging first, so that nothing aliases."""
    scale = float(np.sqrt(abs(np.linalg.det(b_from_a[:, :2]))))
    small = Pyramid(a).at(min(1.0, scale))
    shrink = np.array([small.mask.shape[1] / a.mask.shape[1], small.mask.shape[0] / a.mask.shape[0]])
    linear = b_from_a[:, :2] / shrink
    # OpenCV counts from the centre of the first pixel, on both sides.
    matrix = np.column_stack([linear, b_from_a[:, 2] + linear @ [0.5, 0.5] - 0.5])
    rgb = cv2.warpAffine(small.rgb, matrix, size, flags=cv2.INTER_LINEAR)
    mask = cv2.warpAffine(small.mask.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR) > 0.99
    height = None
    if small.height is not None:
        known = np.isfinite(small.height).astype(np.float32)
        share = cv2.warpAffine(known, matrix, size, flags=cv2.INTER_LINEAR)
        filled = np.where(known > 0, small.height, 0).astype(np.float32)
        total = cv2.warpAffine(filled, matrix, size, flags=cv2.INTER_LINEAR)
        # Pyramid keeps heights in units of the reduced image's pixel; what is left of the scale follows here.
        rest = np.float32(scale / min(1.0, scale))
        height = np.where(share > 0.99, total / np.maximum(share, 1e-6) * rest, np.nan).astype(np.float32)
    return Raster(rgb, mask, height)


def _covered(a: Raster, b: Raster, b_from_a: Array, margin_px: int) -> tuple[int, int, int, int]:
    """First pixel and size of the part of b that a covers; at least one pixel."""
    rows, columns = np.nonzero(a.mask)
    corners = np.array([[x, y] for x in (columns.min(), columns.max() + 1) for y in (rows.min(), rows.max() + 1)])
    placed = corners @ b_from_a[:, :2].T + b_from_a[:, 2]
    h, w = b.mask.shape
    low = np.clip(np.floor(placed.min(axis=0)).astype(int) - margin_px, 0, [w - 1, h - 1])
    high = np.clip(np.ceil(placed.max(axis=0)).astype(int) + margin_px, low + 1, [w, h])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _crop(b: Raster, u0: int, v0: int, width: int, height: int) -> Raster:
    part = (slice(v0, v0 + height), slice(u0, u0 + width))
    return Raster(b.rgb[part], b.mask[part], None if b.height is None else b.height[part])


def _compose(outer: Array, inner: Array) -> Array:
    return np.column_stack([outer[:, :2] @ inner[:, :2], outer[:, :2] @ inner[:, 2] + outer[:, 2]])
