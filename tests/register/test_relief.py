# SPDX-License-Identifier: Apache-2.0
"""A planted stretch of the heights is found, and decides only where the photos leave it open."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from skymoor.register import Relief, compare_relief, focal_correction
from skymoor.types import Array32, Calibration

CERTAIN = Calibration(True, 500, 0.001, 0.99, 1.01, False)
VAGUE = Calibration(True, 500, 0.001, 0.7, 1.3, True)


def town(rng: np.random.Generator, shape: tuple[int, int] = (300, 360)) -> Array32:
    """Houses of 4 to 9 m on rolling ground, 0.5 m pixels."""
    height = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), 30)
    height *= 1.5 / height.std()
    for _ in range(40):
        v, u = rng.integers(0, shape[0] - 40), rng.integers(0, shape[1] - 40)
        height[v : v + rng.integers(16, 36), u : u + rng.integers(16, 36)] += rng.uniform(4, 9)
    return height


@pytest.mark.parametrize("ratio", [0.8, 1.0, 1.15])
def test_planted_stretch_is_found_within_its_sigma(ratio: float, rng: np.random.Generator) -> None:
    truth = town(rng)
    model = truth / np.float32(ratio) + rng.normal(0, 0.1, truth.shape).astype(np.float32)
    model[rng.random(model.shape) < 0.2] = np.nan
    tilt = 0.01 * np.arange(truth.shape[1], dtype=np.float32)  # a plane is not relief
    reference = cv2.GaussianBlur(truth, (0, 0), 1.2) + tilt + 7
    found = compare_relief(model, reference, 0.5)
    assert found is not None
    assert abs(found.ratio - ratio) < 2.5 * found.sigma
    assert 0.02 < found.sigma < 0.08


def test_flat_ground_decides_nothing(rng: np.random.Generator) -> None:
    noise = rng.normal(0, 0.1, (2, 300, 300)).astype(np.float32)
    found = compare_relief(noise[0], noise[1], 0.5)
    assert found is None or focal_correction(found, VAGUE) is None or found.sigma > 0.2


def test_too_little_common_ground_is_none() -> None:
    nothing = np.full((100, 100), np.nan, np.float32)
    nothing[:6, :6] = 1
    assert compare_relief(nothing, np.ones((100, 100), np.float32), 0.5) is None


def test_correction_only_where_the_photos_leave_it_open() -> None:
    relief = Relief(0.85, 0.03)
    assert focal_correction(relief, CERTAIN) is None
    assert focal_correction(None, VAGUE) is None
    assert focal_correction(relief, None) is None
    assert focal_correction(Relief(1.005, 0.03), VAGUE) is None
    corrected = focal_correction(relief, VAGUE)
    assert corrected is not None
    ratio, sigma = corrected
    assert 0.85 < ratio < 0.86 and 0.03 < sigma < 0.036


def test_two_witnesses_of_one_number_are_weighed() -> None:
    """Photos sure to 5 percent and a relief sure to 5 percent meet half way."""
    halfway = focal_correction(Relief(0.8, 0.04), Calibration(True, 500, 0.0, 0.95, 1.05, True))
    assert halfway is not None
    assert halfway[0] == pytest.approx(0.8**0.5, rel=0.01) and halfway[1] == pytest.approx(0.05 / 2**0.5, rel=0.01)
