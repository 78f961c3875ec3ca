# SPDX-License-Identifier: Apache-2.0
"""Height scale of the model by the reference's relief.

A block of photos from one height does not separate focal length and flying height: the whole model may be too tall or
too flat by one factor. The reference's heights determine it. Both height maps are blurred alike, so that smoothness of
the reference is not mistaken for flatness, and compared over the common area up to a plane.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from skymoor.engines.options import FIXED
from skymoor.types import Array, Array32, Calibration


@dataclass(frozen=True)
class HeightScaleOptions:
    """When the reference's relief corrects the focal length.

    Attributes:
        blur_m: Gaussian sigma by which both height maps are blurred.
        systematic_ratio: lower bound of the estimate's relative sigma (blurred edges, trees, growth).
        significance: standard deviations by which the correction must differ from none.
    """

    blur_m: float = field(default=1.0, metadata=FIXED)
    systematic_ratio: float = field(default=0.025, metadata=FIXED)
    significance: float = 1.0


@dataclass(frozen=True)
class HeightScale:
    """Ratio of reference heights to model heights, 1 for a correct focal length, and its standard deviation."""

    ratio: float
    sigma: float


def shared_heights(
    a: Array32, b: Array32, pixel_m: float, blur_m: float
) -> tuple[Array, Array32, Array32, float] | None:
    """Two height maps (h, w) in metres on one grid, NaN where unknown, blurred alike where both are known.

    Returns:
        the design (n, 3) of a plane over at most some twenty thousand pixels, the heights of both there (n,), and the
        number of independent areas of a few metres that they share; None for less than 20 of these.
    """
    known = np.isfinite(a) & np.isfinite(b)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), blur_m / pixel_m)
    rows, columns = np.nonzero(known & (weight > 0.7))
    areas = len(rows) * pixel_m**2 / (4 * np.pi * (blur_m**2 + 1))
    if areas < 20:
        return None
    step = max(1, len(rows) // 20000)
    rows, columns = rows[::step], columns[::step]
    blurred_a, blurred_b = (
        cv2.GaussianBlur(np.where(known, x, 0).astype(np.float32), (0, 0), blur_m / pixel_m)[rows, columns]
        / weight[rows, columns]
        for x in (a, b)
    )
    scale = max(known.shape)
    plane = np.column_stack([columns / scale, rows / scale, np.ones(len(rows))])
    return plane, blurred_a, blurred_b, areas


def estimate_height_scale(
    model_height: Array32, reference_height: Array32, pixel_m: float, options: HeightScaleOptions | None = None
) -> HeightScale | None:
    """Compare two height maps (h, w) in metres on one grid, NaN where unknown; None where they overlap too little.

    The model's must already have the registration's scale. Robust linear regression (Tukey) with a plane as nuisance;
    the number of independent areas follows from the blur.
    """
    options = options or HeightScaleOptions()
    shared = shared_heights(model_height, reference_height, pixel_m, options.blur_m)
    if shared is None:
        return None
    plane, model, reference, areas = shared
    design = np.column_stack([model, plane]).astype(np.float64)
    weights = np.ones(len(model))
    for _ in range(20):
        root = np.sqrt(weights)[:, None]
        solution, *_ = np.linalg.lstsq(design * root, reference * root[:, 0], rcond=None)
        residual = reference - design @ solution
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-3)
        weights = np.clip(1 - (residual / (4.685 * spread)) ** 2, 0, None) ** 2
    normal = (design.T * weights) @ design
    if np.linalg.cond(normal) > 1e10:
        return None
    variance = float(np.linalg.inv(normal)[0, 0]) * spread**2 * max(1.0, len(model) / areas)
    return HeightScale(float(solution[0]), float(np.hypot(np.sqrt(variance), options.systematic_ratio)))


def focal_correction(
    relief: HeightScale | None, calibration: Calibration | None, options: HeightScaleOptions | None = None
) -> tuple[float, float] | None:
    """Factor for the focal length and its relative standard deviation afterwards; None for no correction.

    The interval from the photos and the ratio from the relief are combined as two measurements, in logarithms.
    """
    options = options or HeightScaleOptions()
    if relief is None or calibration is None or not calibration.uncertain or relief.ratio <= 0.3:
        return None
    photo_sigma = max(calibration.focal_sigma, 1e-3)
    log_sigma = relief.sigma / relief.ratio
    share = photo_sigma**2 / (photo_sigma**2 + log_sigma**2)
    ratio = float(np.exp(share * np.log(relief.ratio)))
    sigma = float(np.sqrt(share) * log_sigma)
    if abs(np.log(ratio)) < options.significance * sigma:
        return None
    return ratio, sigma
