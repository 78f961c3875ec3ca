# SPDX-License-Identifier: Apache-2.0
"""Warp one raster to the other by a hypothesis, match the two, and return the matches in their original pixels."""

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
    """Cyclically consistent matches of `a` in `b`, from an approximate transform.

    Args:
        a, b: the rasters.
        b_from_a: (2, 3) approximate affine from pixels of a to pixels of b: a similarity, from a search or an earlier
            registration.
        matcher: matches `a`, resampled to the pixels of b, with the part of b that it covers.
        options: thresholds, in pixels of b.
        rng: draws the subset where there are more than `max_matches`.
        margin_px: border around the covered part, in pixels of b.

    Returns:
        the matches in pixels of a and of b, and the dense warp between warped `a` and the covered part of b.
    """
    u0, v0, width, height = _covered(a, b, b_from_a, margin_px)
    shift = np.array([[1, 0, -u0], [0, 1, -v0]], dtype=np.float64)
    crop_from_a = _compose(shift, b_from_a)
    warp = matcher(warp_raster(a, crop_from_a, (width, height)), _crop(b, u0, v0, width, height))
    matches = cyclic_matches(warp, options, rng=rng)
    a_from_crop = cv2.invertAffineTransform(crop_from_a)
    px_a = matches.px_a @ a_from_crop[:, :2].T + a_from_crop[:, 2]
    return replace(matches, px_a=px_a, px_b=matches.px_b + [u0, v0]), warp


def warp_raster(a: Raster, b_from_a: Array, size: tuple[int, int]) -> Raster:
    """Resample `a` by a similarity to `size` (width, height), reduced by averaging first to avoid aliasing.

    Heights keep their convention: on return they are in units of the output pixel.
    """
    scale = float(np.sqrt(abs(np.linalg.det(b_from_a[:, :2]))))
    small = Pyramid(a).at(min(1.0, scale))
    shrink = np.array([small.mask.shape[1] / a.mask.shape[1], small.mask.shape[0] / a.mask.shape[0]])
    linear = b_from_a[:, :2] / shrink
    # OpenCV's origin is the centre of the first pixel, in both images.
    matrix = np.column_stack([linear, b_from_a[:, 2] + linear @ [0.5, 0.5] - 0.5])
    rgb = cv2.warpAffine(small.rgb, matrix, size, flags=cv2.INTER_LINEAR)
    mask = cv2.warpAffine(small.mask.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR) > 0.99
    height = None
    if small.height is not None:
        known = np.isfinite(small.height).astype(np.float32)
        fraction = cv2.warpAffine(known, matrix, size, flags=cv2.INTER_LINEAR)
        filled = np.where(known > 0, small.height, 0).astype(np.float32)
        total = cv2.warpAffine(filled, matrix, size, flags=cv2.INTER_LINEAR)
        # Pyramid keeps heights in units of the reduced pixel; the rest of the scale is applied here.
        remaining = np.float32(scale / min(1.0, scale))
        height = np.where(fraction > 0.99, total / np.maximum(fraction, 1e-6) * remaining, np.nan).astype(np.float32)
    return Raster(rgb, mask, height)


def _covered(a: Raster, b: Raster, b_from_a: Array, margin_px: int) -> tuple[int, int, int, int]:
    """First pixel (u, v) and size (width, height) of the part of b that a covers; at least one pixel."""
    rows, columns = np.nonzero(a.mask)
    corners = np.array([[x, y] for x in (columns.min(), columns.max() + 1) for y in (rows.min(), rows.max() + 1)])
    corners_b = corners @ b_from_a[:, :2].T + b_from_a[:, 2]
    h, w = b.mask.shape
    low = np.clip(np.floor(corners_b.min(axis=0)).astype(int) - margin_px, 0, [w - 1, h - 1])
    high = np.clip(np.ceil(corners_b.max(axis=0)).astype(int) + margin_px, low + 1, [w, h])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _crop(b: Raster, u0: int, v0: int, width: int, height: int) -> Raster:
    part = (slice(v0, v0 + height), slice(u0, u0 + width))
    return Raster(b.rgb[part], b.mask[part], None if b.height is None else b.height[part])


def _compose(outer: Array, inner: Array) -> Array:
    return np.column_stack([outer[:, :2] @ inner[:, :2], outer[:, :2] @ inner[:, 2] + outer[:, 2]])
