# SPDX-License-Identifier: Apache-2.0
"""Elevation models that users have, made from a better one: coarse, without buildings, flat, in feet, old.

Heights are (h, w) float64 with NaN where unknown. A variant is a function of heights and their pixel size in metres;
it gives heights and how many pixels of the original, per side, one of its pixels covers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio import Affine
from scipy import ndimage

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Variant = Callable[[Array, float], tuple[Array, int]]

NODATA = -9999.0
FEET_PER_M = 1 / 0.3048
OFFSET_M = 35.0  # about what an unnoticed geoid makes
WINDOW_M = 40.0  # widest building that is removed
STEPS = ((0.30, 20.0), (0.12, 12.0))  # slope of what is ground, and the blur in metres of the trend for the next step
RAISED_M, RAISED_M2, OLD_SHARE = 2.5, 30.0, 0.1


@dataclass(frozen=True, eq=False)
class Elevation:
    """Heights (h, w) of a file, NaN where unknown, and their pixel size in metres."""

    heights: Array
    pixel_m: float
    transform: Affine
    crs: rasterio.crs.CRS

    @classmethod
    def read(cls, path: Path) -> Elevation:
        """The first band."""
        with rasterio.open(path) as file:
            heights = file.read(1, masked=True).astype(np.float64).filled(np.nan)
            metres = 111_320.0 if file.crs.is_geographic else float(file.crs.linear_units_factor[1])
            return cls(heights, abs(file.transform.e) * metres, file.transform, file.crs)

    def write(self, path: Path, heights: Array, factor: int) -> None:
        """Other heights in the same place, whose pixels are larger by `factor`."""
        bands = np.where(np.isfinite(heights), heights, NODATA).astype(np.float32)[None]
        layout = {"count": 1, "height": bands.shape[1], "width": bands.shape[2], "dtype": "float32", "nodata": NODATA}
        transform = self.transform * Affine.scale(factor)
        with rasterio.open(path, "w", driver="GTiff", crs=self.crs, transform=transform, **layout) as file:
            file.write(bands)


def means(pixel_m: float) -> Variant:
    """Block means of the known heights; the last row and column may cover less than a block."""

    def variant(heights: Array, own_m: float) -> tuple[Array, int]:
        factor = max(round(pixel_m / own_m), 1)
        padded = np.pad(heights, [(0, -side % factor) for side in heights.shape], constant_values=np.nan)
        blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
        count = np.isfinite(blocks).sum(axis=(1, 3))
        total = np.nansum(blocks, axis=(1, 3))
        return np.where(count > 0, total / np.maximum(count, 1), np.nan), factor

    return variant


def upsampled(heights: Array, pixel_m: float) -> tuple[Array, int]:
    """Means over 30 m, interpolated bilinearly to the original pixels: a file that claims more than it holds."""
    coarse, factor = means(30.0)(heights, pixel_m)
    rows, columns = ((np.arange(side) + 0.5) / factor - 0.5 for side in heights.shape)
    where = np.stack(np.meshgrid(rows, columns, indexing="ij"))
    return np.asarray(ndimage.map_coordinates(filled(coarse), where, order=1, mode="nearest")), 1


def bare(heights: Array, pixel_m: float) -> tuple[Array, int]:
    """The ground, by a progressive morphological filter like SMRF (Pingel et al. 2013), twice for the sake of slopes.

    What an opening lowers by more than a slope allows is no ground; the second time the slope counts from the trend.
    """
    surface = filled(heights)
    pits = _closed(surface, 5.0 / pixel_m) - surface > 1.5
    trend = np.full_like(surface, np.median(surface))
    for slope, blur_m in STEPS:
        rest = surface - trend
        ground = trend + interpolated(rest, pits | _raised(rest, slope, pixel_m), pixel_m)
        trend = _blurred(ground, blur_m / pixel_m)
    return _blurred(ground, 2.0 / pixel_m), 1


def flat(heights: Array, pixel_m: float) -> tuple[Array, int]:
    """One height everywhere."""
    return np.full_like(heights, np.nanmedian(heights)), 1


def feet(heights: Array, pixel_m: float) -> tuple[Array, int]:
    """In feet, and nothing says so."""
    return heights * FEET_PER_M, 1


def offset(heights: Array, pixel_m: float) -> tuple[Array, int]:
    """All too high."""
    return heights + OFFSET_M, 1


def old(heights: Array, pixel_m: float) -> tuple[Array, int]:
    """Before a tenth of what stands there was built or had grown: at least one thing is missing."""
    ground, _ = bare(heights, pixel_m)
    pieces, count = ndimage.label(np.nan_to_num(heights - ground) > RAISED_M)
    areas = np.bincount(pieces.ravel(), minlength=count + 1) * pixel_m**2
    large = np.flatnonzero(areas > RAISED_M2)
    large = large[large > 0]
    if not len(large):
        return heights, 1
    missing = np.random.default_rng(0).choice(large, max(round(OLD_SHARE * len(large)), 1), replace=False)
    around = ndimage.binary_dilation(np.isin(pieces, missing), iterations=max(round(1.5 / pixel_m), 1))
    return np.where(around, ground, heights), 1


VARIANTS: dict[str, Variant] = {
    "10m": means(10.0),
    "30m": means(30.0),
    "bare": bare,
    "flat": flat,
    "feet": feet,
    "offset": offset,
    "old": old,
    "upsampled30": upsampled,
}


def filled(heights: Array) -> Array:
    """Unknown heights become those of the nearest known place."""
    unknown = ~np.isfinite(heights)
    nearest = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(heights[tuple(nearest)])


def interpolated(surface: Array, holes: Mask, pixel_m: float) -> Array:
    """The surface with its holes closed from their borders, each by the narrowest blur that reaches it."""
    known = (~holes).astype(np.float64)
    result = np.where(holes, np.nan, surface)
    for sigma_m in (2.0, 4.0, 8.0, 16.0, 32.0, 64.0):
        weight = _blurred(known, sigma_m / pixel_m)
        estimate = _blurred(np.where(holes, 0.0, surface), sigma_m / pixel_m) / np.maximum(weight, 1e-9)
        result = np.where(np.isnan(result) & (weight > 0.1), estimate, result)
    return filled(result)


def _raised(rest: Array, slope: float, pixel_m: float) -> Mask:
    """What windows that grow up to `WINDOW_M` find to stand above the ground, with a margin."""
    raised = np.zeros(rest.shape, bool)
    before = rest.astype(np.float32)
    radius_m = max(1.0, pixel_m)
    while 2 * radius_m <= WINDOW_M:
        radius = max(round(radius_m / pixel_m), 1)
        window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
        opened = cv2.morphologyEx(before, cv2.MORPH_OPEN, window, borderType=cv2.BORDER_REPLICATE)
        raised |= before - opened > 0.5 + slope * min(radius_m, 5.0)
        before, radius_m = opened, radius_m * 1.5
    return np.asarray(ndimage.binary_dilation(raised, iterations=max(round(1.5 / pixel_m), 1)))


def _closed(surface: Array, window_px: float) -> Array:
    """Without what is lower than all around it and narrower than a window."""
    window = np.ones((round(window_px) | 1, round(window_px) | 1), np.uint8)
    return np.asarray(cv2.morphologyEx(surface.astype(np.float32), cv2.MORPH_CLOSE, window), np.float64)


def _blurred(values: Array, sigma_px: float) -> Array:
    return np.asarray(ndimage.gaussian_filter(values, max(sigma_px, 0.3), mode="nearest"))
