# SPDX-License-Identifier: Apache-2.0
"""Heights are confirmed where the relief says so, and known errors of elevation models are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.registration import HeightFit, focal_posterior, judge_heights
from skymoor.types import Calibration, HeightVerdict

WIDE = Calibration(True, 500.0, 0.001, 0.7, 1.34, True)
NARROW = Calibration(True, 500.0, 0.0005, 0.99, 1.01, False)


def fit(scale: float, sigma: float, **change: object) -> HeightFit:
    covariance = np.diag([1e-4, 1e-4, 1e-4, sigma**2])
    found = HeightFit(scale, 0.2, np.zeros(2), covariance, np.zeros(3), 0.3, 2.0, 2.0 * abs(scale), 2.4, 40)
    return replace(found, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("scale", "sigma", "calibration", "status", "words"),
    [
        (1.0, 0.03, NARROW, "CONFIRMED", ""),
        (1.0, 0.03, None, "CONFIRMED", ""),
        (0.86, 0.08, WIDE, "CONFIRMED", ""),
        (0.94, 0.17, WIDE, "CONFIRMED", ""),
        (3.28, 0.1, NARROW, "NOT_CONFIRMED", "3.28 +- 0.10 times the model's, and the photos allow 0.99 to 1.01: are"),
        (2.81, 0.25, WIDE, "NOT_CONFIRMED", "feet"),
        (0.31, 0.03, NARROW, "NOT_CONFIRMED", "as if they were feet"),
        (2.0, 0.1, NARROW, "NOT_CONFIRMED", "exaggerated"),
        (-1.0, 0.1, NARROW, "NOT_CONFIRMED", "depths"),
        (0.6, 0.05, NARROW, "NOT_CONFIRMED", "does the elevation model belong to the orthophoto"),
        (0.02, 0.05, NARROW, "OFFSET_ONLY", "where the reference has none: is it flat, or a terrain model"),
        (0.9, 0.5, NARROW, "OFFSET_ONLY", "too small, or the elevation model too coarse"),
        (float("nan"), float("inf"), NARROW, "OFFSET_ONLY", "too small for the resolution"),
        (2.95, 0.87, WIDE, "NOT_CONFIRMED", "feet"),
        (1.7, 0.1, replace(WIDE, focal_high_ratio=1.5), "OFFSET_ONLY", "does not tell right from wrong"),
    ],
)
def test_each_verdict(scale: float, sigma: float, calibration: Calibration | None, status: str, words: str) -> None:
    found = judge_heights(fit(scale, sigma), calibration)
    assert found.status == status and words in found.reason
    assert (found.scale is None) == np.isnan(scale)


def test_no_heights_and_flat_heights() -> None:
    assert judge_heights(None, NARROW) == HeightVerdict("NOT_CONFIRMED", "the reference has no heights here")
    flat = judge_heights(fit(0.0, 0.01, reference_relief_m=0.0), NARROW)
    assert flat.status == "OFFSET_ONLY" and "flat" in flat.reason


def test_a_terrain_model_is_named_although_open_ground_agrees() -> None:
    found = judge_heights(fit(1.0, 0.03), NARROW, bare=True)
    assert found.status == "CONFIRMED" and "terrain model" in found.reason


def test_wrong_scales_are_confirmed_as_seldom_as_stated() -> None:
    """Of right ones, nearly all are; of each known error, fewer than one in a hundred, over ratios drawn with noise."""
    rng = np.random.default_rng(0)
    for truth, low, high in ((1.0, 0.97, 1.0), (3.2808, 0, 0.01), (0.3048, 0, 0.01), (2.0, 0, 0.01), (0.0, 0, 0.01)):
        sigma = 0.08 * max(truth, 0.5)
        verdicts = [judge_heights(fit(truth + sigma * rng.normal(), sigma), NARROW).status for _ in range(500)]
        assert low <= np.mean([one == "CONFIRMED" for one in verdicts]) <= high


class TestFocalPosterior:
    def test_relief_decides_where_the_photos_do_not(self) -> None:
        verdict = judge_heights(fit(0.86, 0.05), WIDE)
        found = focal_posterior(verdict, WIDE)
        assert found is not None
        ratio, sigma = found
        assert 0.86 < ratio < 0.875 and 0.9 * 0.05 / 0.86 < sigma < 0.05 / 0.86

    def test_photos_decide_where_they_can(self) -> None:
        found = focal_posterior(judge_heights(fit(1.05, 0.05), NARROW), NARROW)
        assert found is not None
        assert found[0] == pytest.approx(1.0, abs=0.003) and 0.0055 < found[1] < 0.0062

    def test_both_count_by_their_precision(self) -> None:
        """Equal ones meet in the middle, and are better than each by the root of two."""
        half = 0.1 * LE90_PER_SIGMA
        calibration = replace(WIDE, focal_low_ratio=1 - half, focal_high_ratio=1 + half)
        found = focal_posterior(judge_heights(fit(1.1, 0.11), calibration), calibration)
        assert found is not None
        assert np.log(found[0]) == pytest.approx(np.log(1.1) / 2, rel=1e-6)
        assert found[1] == pytest.approx(0.1 / np.sqrt(2), rel=1e-6)

    def test_heights_that_are_not_confirmed_say_nothing(self) -> None:
        assert focal_posterior(judge_heights(fit(3.28, 0.1), WIDE), WIDE) is None
        assert focal_posterior(judge_heights(fit(0.9, 0.5), WIDE), WIDE) is None
        assert focal_posterior(judge_heights(fit(1.0, 0.05), None), None) is None

    def test_an_uncorrected_deviation_counts_as_an_error(self) -> None:
        narrowed = WIDE.narrowed(1.02, 0.03)
        assert narrowed.focal_sigma == pytest.approx(np.hypot(0.02, 0.03))
        assert narrowed.focal_px == WIDE.focal_px
