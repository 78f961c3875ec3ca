# SPDX-License-Identifier: Apache-2.0
"""False-alarm probabilities are calibrated, of scores and of agreement."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import norm

from skymoor.registration import Agreement, false_alarm_probability
from skymoor.registration.significance import agreement_probability, combined_probability


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


def test_an_agreement_beyond_that_of_decoys_is_significant() -> None:
    """Shares of wrong hypotheses as measured; right ones agree in nearly all cells."""
    decoys = [Agreement(3, 7), Agreement(4, 13), Agreement(2, 12), Agreement(15, 22)]
    assert agreement_probability(Agreement(32, 32), decoys) < 0.005
    assert agreement_probability(Agreement(6, 36), decoys) > 0.3
    assert agreement_probability(Agreement(265, 266), [Agreement(8, 247), Agreement(6, 23)]) < 0.001
    assert agreement_probability(Agreement(32, 32), []) == 1.0


def test_agreement_probabilities_are_calibrated(rng: np.random.Generator) -> None:
    found = []
    for _ in range(3000):
        shares = 1 / (1 + np.exp(1.5 - 0.75 * rng.normal(size=5)))
        *decoys, other = (Agreement(round(400 * share), 400) for share in shares)
        found.append(agreement_probability(other, decoys))
    assert 0.03 < np.mean(np.array(found) < 0.05) < 0.07


def test_one_strong_evidence_is_enough_and_two_weak_ones_are_not() -> None:
    assert combined_probability([1e-6, 0.3]) == pytest.approx(2e-6, rel=0.01)
    assert combined_probability([0.0064, 3e-5]) < 1e-4
    assert combined_probability([0.02, 0.02]) == pytest.approx(0.02, rel=1e-6)
    assert combined_probability([1e-14, 1e-14]) == pytest.approx(1e-14, rel=0.01)
    assert combined_probability([1.0, 1.0]) > 0.99


def test_the_combination_holds_for_evidence_that_depends_on_each_other(rng: np.random.Generator) -> None:
    """Probabilities of correlated normal deviates: no more than the stated share is below 1 %."""
    for correlation in (0.0, 0.7, 0.99):
        z = rng.normal(size=(20000, 2))
        z[:, 1] = correlation * z[:, 0] + np.sqrt(1 - correlation**2) * z[:, 1]
        combined = np.array([combined_probability(p) for p in norm.sf(z)])
        assert 0.005 < np.mean(combined < 0.01) < 0.0125
