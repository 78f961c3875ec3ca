# SPDX-License-Identifier: Apache-2.0
"""Ground under houses and trees, and elevation models that show it alone (terrain models, DTM)."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.registration.detail import WORKING_M, averaged
from skymoor.types import Array32, Mask

RAISED_M = 2.5  # above ground: houses and trees
GROUND_WINDOW_M = 40.0  # wider than houses
MIN_RAISED_M2 = 100.0
BARE_RATIO = 0.3
"""Median ratio of heights above ground below which a reference does not show what the model does; surface models of our
sites had 0.7 to 1.1, terrain models 0 to 0.05."""


def ground_level(height: Array32, pixel_m: float) -> Array32:
    """Height (h, w) of the ground under houses and trees: opening by a window wider than they are; NaN stays NaN."""
    step = max(1, round(WORKING_M / pixel_m))
    small = averaged(height, step)
    known = np.isfinite(small)
    if not known.any():
        return np.full_like(height, np.nan)
    side = 2 * round(GROUND_WINDOW_M / (2 * step * pixel_m)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    far = np.float32(1e6)
    smooth = cv2.medianBlur(np.where(known, small, np.nanmedian(small)).astype(np.float32), 5)
    low = cv2.erode(np.where(known, smooth, far), kernel, borderValue=float(far))
    low = cv2.dilate(np.where(low < far / 2, low, -far), kernel, borderValue=-float(far))
    full = cv2.resize(low, (height.shape[1], height.shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.where(np.isfinite(height) & (np.abs(full) < far / 2), np.minimum(full, height), np.nan).astype(np.float32)


def raised(height: Array32, pixel_m: float) -> Mask:
    """Pixels (h, w) of a surface in metres that are houses and trees; False where unknown."""
    with np.errstate(invalid="ignore"):
        return np.asarray(height - ground_level(height, pixel_m) > RAISED_M)


def is_bare_earth(model: Array32, reference: Array32, pixel_m: float) -> bool:
    """Whether the reference lies at the ground where the model has houses and trees; (h, w) metres on one grid."""
    # On one area: what an opening does at the border of a slope is the same for both then.
    reference = np.where(np.isfinite(model), reference, np.nan).astype(np.float32)
    above = model - ground_level(model, pixel_m)
    of_reference = reference - ground_level(reference, pixel_m)
    with np.errstate(invalid="ignore"):
        both = (above > RAISED_M) & np.isfinite(of_reference)
    if np.count_nonzero(both) * pixel_m**2 < MIN_RAISED_M2:
        return False
    return float(np.median(of_reference[both] / above[both])) < BARE_RATIO
