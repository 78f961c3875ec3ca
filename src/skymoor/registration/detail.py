# SPDX-License-Identifier: Apache-2.0
"""Detail of elevation models: averaging and blurring with unknown heights, and the blur that a surface has itself."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.types import Array32

WORKING_M = 1.0
"""Both maps are averaged to pixels of this size, at least: finer detail says nothing of heights at large."""
BLUR_M = 1.0
BLURS_M = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
"""Gaussian sigmas at which the elevation model's detail is measured, and which are tried as its blur."""
SMOOTH = 3.0
"""Growth of detail with its size, as an exponent, above which a surface is smooth: edges have 1, interpolated cells 3
to 8; measured on four elevation models and their means over 10 and 30 m (bilinear interpolation is a blur of half a
cell, which is 1.2 to 1.4 times the size at which the exponent falls below 3)."""
SHARP_M, SHARP_PX, BLUR_RANGE = 1.4, 3.0, (0.8, 2.4)
KNOWN_SHARE = 0.6  # of the blurring window


def blur_range(reference: Array32, pixel_m: float, dsm_pixel_m: float) -> tuple[float, float]:
    """Smallest and largest Gaussian blur (sigma, metres) that an elevation model's detail, or its file's pixel, allows.

    Detail of a size is what a band-pass of that size leaves (median). It falls off steeply below the resolution.
    """
    least = dsm_pixel_m / 2 if np.isfinite(dsm_pixel_m) and dsm_pixel_m > 2 * BLUR_M else 0.0
    step = max(1, round(WORKING_M / pixel_m))
    surface, size_m = averaged(reference, step), step * pixel_m
    sizes = np.array([size for size in BLURS_M if size < min(surface.shape) * size_m / 8])
    bands = [blurred(surface, 0.8 * size / size_m) - blurred(surface, 1.25 * size / size_m) for size in sizes]
    detail = np.array([float(np.median(np.abs(band[np.isfinite(band)]))) for band in bands if np.isfinite(band).any()])
    # Without a sign of smoothing, the blur is that of a usual surface model.
    sharp = least, max(least, SHARP_M, SHARP_PX * min(dsm_pixel_m, BLUR_M))
    if len(detail) < 2 or not (detail > 0).all():
        return sharp
    growth = 2 * np.diff(np.log(detail)) / np.diff(np.log(sizes[: len(detail)]))
    smooth = int(np.argmax(growth < SMOOTH)) if (growth < SMOOTH).any() else len(growth)
    if smooth == 0:
        return sharp
    size = float(sizes[smooth])
    return max(least, BLUR_RANGE[0] * size), max(least, BLUR_RANGE[1] * size)


def averaged(values: Array32, step: int) -> Array32:
    """Means of blocks of `step` pixels over the known ones; NaN where most are unknown."""
    if step == 1 or min(values.shape) < step:
        return values
    rows, columns = (side // step for side in values.shape)
    blocks = values[: rows * step, : columns * step].reshape(rows, step, columns, step)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count * 2 > step**2, total / np.maximum(count, 1), np.nan).astype(np.float32)


def blurred(values: Array32, sigma_px: float) -> Array32:
    """Gaussian blur over the known pixels; NaN where the window holds too few of them."""
    if sigma_px < 0.3:
        return values
    known = np.isfinite(values).astype(np.float32)
    middle = np.float32(np.nanmedian(values)) if known.any() else np.float32(0)
    total = cv2.GaussianBlur(np.where(known > 0, values - middle, 0).astype(np.float32), (0, 0), sigma_px)
    share = cv2.GaussianBlur(known, (0, 0), sigma_px)
    good = (share >= KNOWN_SHARE) & (known > 0)
    return np.where(good, total / np.maximum(share, 1e-6) + middle, np.nan).astype(np.float32)
