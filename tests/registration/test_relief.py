# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from skymoor.registration import HeightScale, HeightScaleOptions, estimate_height_scale, focal_correction
from skymoor.types import Calibration
from support.pictures import Overhead

Array = NDArray[np.float64]
PIXEL_M = 0.5


@pytest.fixture(scope="module")
def truth(first_day: Overhead) -> Array:
    """Heights of the small world, 90 by 80 m."""
    east, north = np.meshgrid(np.arange(-45, 45, PIXEL_M), np.arange(40, -40, -PIXEL_M))
    return first_day.heights_at(np.stack([east, north], axis=-1)).astype(np.float64)


def noisy(height: Array, sigma: float, seed: int) -> NDArray[np.float32]:
    return (height + np.random.default_rng(seed).normal(scale=sigma, size=height.shape)).astype(np.float32)


@pytest.mark.parametrize("ratio", [0.8, 1.0, 1.25])
def test_a_planted_ratio_comes_back(truth: Array, ratio: float) -> None:
    plane = 0.03 * np.arange(truth.shape[1]) - 0.02 * np.arange(truth.shape[0])[:, None] + 7
    relief = estimate_height_scale(noisy(truth / ratio + plane, 0.05, 0), noisy(truth, 0.15, 1), PIXEL_M)
    assert relief is not None
    assert relief.ratio == pytest.approx(ratio, rel=0.015)
    assert abs(relief.ratio - ratio) < 2 * relief.sigma
    assert 0.02 < relief.sigma < 0.06


def test_changed_buildings_and_holes_do_not_decide(truth: Array) -> None:
    model, reference = noisy(truth / 1.1, 0.05, 0), noisy(truth, 0.15, 1)
    reference[10:40, 20:60] += 9
    model[100:130, 60:120] = np.nan
    reference[:, 150:] = np.nan
    relief = estimate_height_scale(model, reference, PIXEL_M)
    assert relief is not None and relief.ratio == pytest.approx(1.1, rel=0.03)


def test_a_smoother_reference_is_not_a_flatter_one(truth: Array) -> None:
    smooth = gaussian_filter(truth, 2.0)  # a metre: what the comparison allows for
    relief = estimate_height_scale(noisy(truth, 0.05, 0), noisy(smooth, 0.15, 1), PIXEL_M)
    assert relief is not None and relief.ratio == pytest.approx(1.0, abs=0.06)


def test_flat_ground_gives_a_large_sigma(truth: Array) -> None:
    relief = estimate_height_scale(noisy(0 * truth, 0.02, 0), noisy(0 * truth, 0.15, 1), PIXEL_M)
    assert relief is None or relief.sigma > 0.3


def test_too_little_overlap_gives_no_result(truth: Array) -> None:
    reference = np.full_like(truth, np.nan)
    reference[:12, :12] = truth[:12, :12]
    assert estimate_height_scale(noisy(truth, 0.05, 0), reference.astype(np.float32), PIXEL_M) is None
    assert estimate_height_scale(noisy(truth, 0.05, 0), np.full(truth.shape, np.nan, np.float32), PIXEL_M) is None


class TestFocalCorrection:
    WIDE = Calibration(True, 400.0, 0.01, 0.8, 1.2, True)

    def test_a_precise_relief_decides_over_wide_bounds(self) -> None:
        found = focal_correction(HeightScale(1.15, 0.03), self.WIDE)
        assert found is not None
        ratio, sigma = found
        assert 1.13 < ratio < 1.15
        assert 0.02 < sigma < 0.03

    def test_two_measurements_of_equal_worth_meet_in_the_middle(self) -> None:
        narrow = Calibration(True, 400.0, 0.001, 0.94, 1.06, True)
        found = focal_correction(HeightScale(1.2, 1.2 * 0.06), narrow)
        assert found is not None
        assert found[0] == pytest.approx(np.sqrt(1.2), rel=1e-6)
        assert found[1] == pytest.approx(0.06 / np.sqrt(2), rel=1e-6)

    @pytest.mark.parametrize(
        ("relief", "calibration"),
        [
            (None, WIDE),
            (HeightScale(1.15, 0.03), None),
            (HeightScale(1.15, 0.03), Calibration(True, 400.0, 0.001, 0.99, 1.01, False)),
            (HeightScale(1.005, 0.03), WIDE),
            (HeightScale(-0.5, 0.03), WIDE),
            (HeightScale(0.1, 0.03), WIDE),
        ],
        ids=["no relief", "no calibration", "certain photos", "no difference", "inverted", "absurd"],
    )
    def test_otherwise_it_is_left_alone(self, relief: HeightScale | None, calibration: Calibration | None) -> None:
        assert focal_correction(relief, calibration) is None

    def test_significance_is_an_option(self) -> None:
        relief = HeightScale(1.05, 0.03)
        assert focal_correction(relief, self.WIDE, HeightScaleOptions(significance=1.0)) is not None
        assert focal_correction(relief, self.WIDE, HeightScaleOptions(significance=3.0)) is None
