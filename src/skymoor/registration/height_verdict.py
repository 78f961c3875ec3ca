# SPDX-License-Identifier: Apache-2.0
"""What the reference says of a model's heights: confirmed, an offset only, or nothing that can be believed.

Photos leave an interval of focal lengths, and with it of height scales. A ratio of reliefs outside of it is an error of
the elevation model, whose likely cause is named. A constant offset of all heights cannot be seen in photos: what the
verdict confirms is the relief, while the offset is as good as the stated vertical datum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.registration.heights import HeightFit
from skymoor.types import Calibration, HeightStatus, HeightVerdict

SIGNIFICANT = 3.0
"""Standard deviations: one right ratio in 370 is beyond them."""
FLAT_M = 0.02  # relief of a reference that is one plane
MOST_LIKELY, UNLIKELY = 0.5, 0.01
"""Probability of a known error from which it is told as the cause, and below which a right scale is confirmed."""


@dataclass(frozen=True)
class Cause:
    """A known error of elevation models: the ratio to the model, odds beforehand, and what to ask the user."""

    ratio: float
    odds: float
    ask: str


CAUSES = (
    Cause(1 / 0.3048, 0.05, "are heights in feet?"),
    Cause(0.3048, 0.01, "were heights in metres converted as if they were feet?"),
    Cause(2.0, 0.01, "are heights exaggerated?"),
    Cause(-1.0, 0.01, "are these depths, counted downwards?"),
)
"""Odds against a right scale: a statement of experience, which matters only where the relief tells little."""
UNKNOWN_CAUSE = "does the elevation model belong to the orthophoto?"


@dataclass(frozen=True)
class Interval:
    """Height scales that the photos leave open, relative to the model's."""

    low: float
    high: float

    def distance(self, ratio: float, sigma: float, factor: float) -> float:
        """Standard deviations from a ratio to the interval times `factor`; logarithmic: errors are relative."""
        if ratio * factor <= 0:
            return abs(ratio - factor) / sigma
        low, high, own = np.log(self.low), np.log(self.high), np.log(ratio / factor)
        return float(max(low - own, own - high, 0.0) / (sigma / abs(ratio)))


def judge_heights(fit: HeightFit | None, calibration: Calibration | None, *, bare: bool = False) -> HeightVerdict:
    """The verdict for a model whose heights were compared with the reference's.

    Args:
        fit: of both; None where the reference has no heights.
        calibration: the focal lengths that the photos leave open; None where they determine it.
        bare: the reference lies at the ground under houses and trees, see `is_bare_earth`; it was compared there alone.
    """
    if fit is None:
        return HeightVerdict("NOT_CONFIRMED", "the reference has no heights here")
    known = np.isfinite(fit.scale)
    figures = {
        "scale": fit.scale if known else None,
        "scale_sigma": fit.scale_sigma if known else None,
        "spread_m": fit.spread_m,
        "resolution_m": fit.resolution_m if np.isfinite(fit.resolution_m) else None,
    }
    status, reason = _verdict(fit, calibration)
    if bare and status == "CONFIRMED":
        reason = "the reference is a terrain model without houses and trees; heights were compared on open ground"
    return HeightVerdict(status, reason, **figures)


def _verdict(fit: HeightFit, calibration: Calibration | None) -> tuple[HeightStatus, str]:
    if fit.reference_relief_m < FLAT_M:
        return "OFFSET_ONLY", "the reference's heights are flat; they give an offset and confirm nothing"
    if not np.isfinite(fit.scale):
        return "OFFSET_ONLY", "the common area is too small for the resolution of the elevation model to compare relief"
    ratio, sigma = fit.scale, fit.scale_sigma
    if abs(ratio) < SIGNIFICANT * sigma:
        if abs(ratio - 1) < SIGNIFICANT * sigma:
            return "OFFSET_ONLY", "the relief is too small, or the elevation model too coarse, to compare height scales"
        return "OFFSET_ONLY", (
            f"the model has relief ({fit.model_relief_m:.1f} m) where the reference has none: is it flat, or a terrain "
            "model without houses and trees?"
        )
    photos = Interval(*(1.0, 1.0) if calibration is None else _bounds(calibration))
    own = photos.distance(ratio, sigma, 1.0)
    likely = min(CAUSES, key=lambda cause: photos.distance(ratio, sigma, cause.ratio))
    probability = probability_of_error(ratio, sigma, photos)
    if own > SIGNIFICANT or probability > MOST_LIKELY:
        fits = photos.distance(ratio, sigma, likely.ratio) <= SIGNIFICANT
        return "NOT_CONFIRMED", (
            f"the reference's relief is {ratio:.2f} +- {sigma:.2f} times the model's, and the photos allow "
            f"{photos.low:.2f} to {photos.high:.2f}: {likely.ask if fits else UNKNOWN_CAUSE}"
        )
    if probability > UNLIKELY:
        return "OFFSET_ONLY", f"the relief (ratio {ratio:.2f} +- {sigma:.2f}) does not tell right from wrong"
    return "CONFIRMED", ""


def probability_of_error(ratio: float, sigma: float, photos: Interval) -> float:
    """Probability that a ratio of reliefs comes of one of the known errors and not of a right elevation model."""
    right = np.exp(-(photos.distance(ratio, sigma, 1.0) ** 2) / 2)
    wrong = sum(cause.odds * np.exp(-(photos.distance(ratio, sigma, cause.ratio) ** 2) / 2) for cause in CAUSES)
    return float(wrong / (right + wrong)) if right + wrong > 0 else 0.0


def _bounds(calibration: Calibration) -> tuple[float, float]:
    return max(calibration.focal_low_ratio, 1e-3), max(calibration.focal_high_ratio, 1e-3)


def focal_posterior(verdict: HeightVerdict, calibration: Calibration | None) -> tuple[float, float] | None:
    """Factor for the focal length and its relative standard deviation, from photos and relief together.

    Both are measurements of one logarithm: the photos' interval around 0, and the ratio of reliefs. None where the
    relief says nothing of it, or heights are not believed.
    """
    if verdict.status == "NOT_CONFIRMED" or verdict.scale is None or verdict.scale_sigma is None or calibration is None:
        return None
    if verdict.scale < SIGNIFICANT * verdict.scale_sigma:
        return None
    photo_sigma, relief_sigma = max(calibration.focal_sigma, 1e-4), verdict.scale_sigma / verdict.scale
    share = photo_sigma**2 / (photo_sigma**2 + relief_sigma**2)
    return float(np.exp(share * np.log(verdict.scale))), float(np.sqrt(share) * relief_sigma)
