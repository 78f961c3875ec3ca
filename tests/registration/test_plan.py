# SPDX-License-Identifier: Apache-2.0
"""Similarities in plan are found among outliers, whatever the heights; lean is found where there is one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.registration import PlanFit, fit_plan
from skymoor.registration.covariance import plan_covariance

Array = NDArray[np.float64]
SCALE, AZIMUTH, SHIFT = 63.0, np.radians(130), np.array([12.0, -25.0])
SIGMA_M = 0.2


def on_map(plan: Array) -> Array:
    c, s = np.cos(AZIMUTH), np.sin(AZIMUTH)
    return np.asarray(SCALE * plan @ [[c, s], [-s, c]] + SHIFT)


def planted(
    n: int = 800, *, outliers: float = 0.0, lean: tuple[float, float] = (0.0, 0.0), seed: int = 0
) -> tuple[Array, Array, Array]:
    """Plan positions, map positions and heights above ground; a third are roofs of 3 to 12 m."""
    rng = np.random.default_rng(seed)
    plan = rng.uniform(-0.7, 0.7, (n, 2))
    above = np.where(rng.uniform(size=n) < 1 / 3, rng.uniform(3, 12, n), rng.uniform(0, 0.3, n))
    # The map shows what is raised at a place that is displaced by the lean.
    east_north = on_map(plan) + above[:, None] * np.array(lean) + rng.normal(size=(n, 2)) * SIGMA_M
    wrong = rng.permutation(n)[: round(outliers * n)]
    east_north[wrong] = rng.uniform([-60, -80], [80, 40], (len(wrong), 2))
    return plan, east_north, above


def fitted(matches: tuple[Array, Array, Array], seed: int = 0) -> PlanFit:
    return fit_plan(*matches, inlier_m=1.0, rng=np.random.default_rng(seed))


@pytest.mark.parametrize("outliers", [0.0, 0.5, 0.8])
def test_a_known_similarity_is_recovered(outliers: float) -> None:
    found = fitted(planted(outliers=outliers, seed=1))
    assert found.scale == pytest.approx(SCALE, rel=1e-3)
    assert np.degrees(found.azimuth_rad) == pytest.approx(130, abs=0.1)
    assert [found.shift.real, found.shift.imag] == pytest.approx(SHIFT, abs=0.08)
    assert found.lean == 0
    assert (1 - outliers) * 0.98 < found.inliers.mean() < 1 - outliers + 0.02
    spread = found.residuals[found.inliers].std(axis=0)
    assert ((spread > 0.8 * SIGMA_M) & (spread < 1.2 * SIGMA_M)).all()


@pytest.mark.parametrize("lean", [(0.3, -0.2), (-0.1, 0.45)])
def test_lean_is_found_and_taken_out(lean: tuple[float, float]) -> None:
    found = fitted(planted(lean=lean, seed=2, outliers=0.2))
    assert [found.lean.real, found.lean.imag] == pytest.approx(lean, abs=0.01)
    assert [found.shift.real, found.shift.imag] == pytest.approx(SHIFT, abs=0.08)
    assert found.inliers.mean() > 0.78


def test_unknown_heights_are_no_lean() -> None:
    plan, east_north, above = planted(seed=3)
    assert fitted((plan, east_north, np.full(len(above), np.nan))).lean == 0


def test_matches_in_one_place_determine_nothing() -> None:
    plan, east_north, above = planted(5, seed=4)
    with pytest.raises((TooFewMatches, DegenerateGeometry)):
        fitted((np.repeat(plan[:1], 5, axis=0), east_north, above))


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.25, 0.1)])
def test_the_covariance_is_that_of_many_trials(lean: tuple[float, float]) -> None:
    """Errors of the middle and of azimuth and scale, in predicted standard deviations, over forty trials."""
    squared = []
    for seed in range(40):
        plan, east_north, above = planted(300, lean=lean, seed=100 + seed)
        found = fitted((plan, east_north, above), seed)
        raised = above if found.lean else None
        middle = on_map(np.zeros((1, 2)))[0]
        offsets = on_map(plan) - middle
        rng = np.random.default_rng(seed)
        covariance, _ = plan_covariance(offsets, found.residuals, found.weights, raised, rng=rng)
        error = np.array(
            [
                np.log(found.scale / SCALE),
                found.azimuth_rad - AZIMUTH,
                *(np.array([found.shift.real, found.shift.imag]) - middle),
            ]
        )
        squared.append(error @ np.linalg.solve(covariance, error))
    assert 0.3 < np.mean(squared) / 4 < 1.6
