# SPDX-License-Identifier: Apache-2.0
"""False-alarm probabilities are calibrated; heights can contradict colours."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from skymoor.registration import false_alarm_probability, height_agreement


def test_false_alarm_probabilities_are_calibrated(rng: np.random.Generator) -> None:
    """Of images that match nowhere, as their decoys, five in a hundred have a probability below 5 %."""
    probabilities = []
    for _ in range(4000):
        *decoys, other = 25 * np.exp(0.12 * rng.normal(size=5))
        probabilities.append(false_alarm_probability(other, decoys))
    assert 0.035 < np.mean(np.array(probabilities) < 0.05) < 0.065
    assert 0.002 < np.mean(np.array(probabilities) < 0.01) < 0.016


def test_it_falls_with_the_score_and_rises_with_the_spread() -> None:
    probabilities = [false_alarm_probability(score, [20.0, 22.0, 24.0, 21.0]) for score in (15, 22, 30, 40, 90)]
    assert all(a > b for a, b in pairwise(probabilities))
    assert probabilities[0] > 0.9 and probabilities[2] > 0.005 and 0 < probabilities[-1] < 1e-4
    assert false_alarm_probability(40, [20, 40, 10, 30]) > false_alarm_probability(40, [24, 26, 25, 25])
    assert false_alarm_probability(40, []) == 1.0 == false_alarm_probability(0, [20.0])


def relief(rng: np.random.Generator) -> np.ndarray:
    field = gaussian_filter(rng.normal(size=(160, 200)), 8)
    return (4 * field / field.std()).astype(np.float32)


def test_the_same_relief_agrees_and_another_does_not(rng: np.random.Generator) -> None:
    height = relief(rng)
    slope = np.linspace(0, 30, 200, dtype=np.float32)
    noisy = height + slope + rng.normal(scale=2.0, size=height.shape).astype(np.float32)
    noisy[:, :20] = np.nan
    same = height_agreement(noisy, height, 0.5)
    assert same is not None and same > 0.9
    others = [height_agreement(relief(rng) + slope, height, 0.5) for _ in range(10)]
    assert np.mean([abs(other or 0) for other in others]) < 0.35
    assert height_agreement(-height, height, 0.5) == pytest.approx(-1, abs=0.01)


def test_where_there_is_nothing_to_agree_about(rng: np.random.Generator) -> None:
    height = relief(rng)
    assert height_agreement(height, 0.02 * height, 0.5) is None
    few = np.full_like(height, np.nan)
    few[:20, :20] = height[:20, :20]
    assert height_agreement(few, height, 0.5) is None
    assert height_agreement(np.full_like(height, np.nan), height, 0.5) is None
