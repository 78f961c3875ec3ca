# SPDX-License-Identifier: Apache-2.0
"""Distances, their predicted accuracy, and what a ray meets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from skymoor.geo import Grid
from skymoor.geometry.adjust import similarity_jacobian
from skymoor.results.read import Result
from skymoor.results.viewer import draped
from skymoor.results.viewer.measure import Picker, RelativeErrors, measured, relative_errors, worst_errors
from skymoor.types import Array
from support.finished import finished_run

POINT = np.array([[0.02, 0.004, -0.002], [0.004, 0.03, 0.006], [-0.002, 0.006, 0.05]])


def similarity_covariance() -> Array:
    """Of log scale, rotation (rad) and shift (m), with all of them correlated."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(7, 7)) * np.array([3e-3, 2e-3, 2e-3, 2e-3, 0.5, 0.5, 0.9])[:, None]
    return root @ root.T / 7


@pytest.mark.parametrize("end", [[40.0, -35.0, 2.0], [0.5, 0.2, 0.0], [1.0, 2.0, 30.0], [-60.0, 80.0, -12.0]])
def test_the_error_of_a_distance_is_that_of_many_trials(end: list[float]) -> None:
    """Each trial moves, turns and scales the model, stretches its heights, and moves both ends by themselves."""
    start, rng, n = np.array([12.0, -7.0, 3.0]), np.random.default_rng(1), 40_000
    points = np.stack([start, start + end])
    covariance = similarity_covariance()
    draws = rng.multivariate_normal(np.zeros(7), covariance, n)
    away = np.einsum("ijk,nk->nij", similarity_jacobian(points), draws)
    away += rng.multivariate_normal(np.zeros(3), POINT, (n, 2))
    height_sigma = 0.007
    away[..., 2] += rng.normal(0, height_sigma, n)[:, None] * points[:, 2]
    seen = np.linalg.norm(np.diff(points + away, axis=1)[:, 0], axis=1)
    found = measured(*points, RelativeErrors(float(np.sqrt(covariance[0, 0])), height_sigma, POINT))
    assert found.distance_m == pytest.approx(np.linalg.norm(end)) and found.height_m == pytest.approx(end[2])
    assert found.error_90_m is not None
    linear = found.distance_m > 2.0  # a distance as short as its error is not linear in it
    within = float(np.mean(np.abs(seen - found.distance_m) <= found.error_90_m))
    assert within == pytest.approx(0.9, abs=0.01 if linear else 0.05)


def test_equal_points_err_in_the_worst_direction() -> None:
    found = measured(np.zeros(3), np.zeros(3), RelativeErrors(0.1, 0.1, np.diag([1.0, 4.0, 2.0])))
    assert found.distance_m == 0 and found.error_90_m == pytest.approx(1.645 * np.sqrt(8), rel=1e-3)
    assert measured(np.zeros(3), np.ones(3), None).error_90_m is None


def _without_heights(run: Path, result: Result) -> RelativeErrors:
    """Of the same run, where hardly any match has a height in the reference."""
    file = run / "matches" / "airborne_0.npz"
    with np.load(file) as kept:
        residuals, inliers = kept["residuals_m"].copy(), kept["inliers"]
    residuals[5:, 2] = np.nan
    np.savez(file, residuals_m=residuals, inliers=inliers)
    found = relative_errors(result, result.components[0])
    assert found is not None
    return found


def test_errors_are_those_of_the_run(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    path = run / "summary.json"
    summary = json.loads(path.read_text())
    air = summary["sets"][0]["components"][0]
    former = worst_errors(Result.read(run))  # its summary has no covariance of the similarity
    assert former is not None and former.scale_sigma == 0
    np.testing.assert_allclose(former.point_covariance, np.diag([0.002, 0.002, 0.06]))
    air["surface_accuracy"]["similarity_covariance"] = similarity_covariance().tolist()
    air["calibration"] = {"focal_sigma_ratio": 0.004}
    path.write_text(json.dumps(summary))
    result = Result.read(run)
    found = relative_errors(result, result.components[0])
    assert found is not None and found.scale_sigma == pytest.approx(np.sqrt(similarity_covariance()[0, 0]))
    assert found.height_sigma == 0.004
    np.testing.assert_allclose(found.point_covariance, np.eye(3) * 0.3**2, atol=0.03)  # the residuals of the run
    assert np.isfinite(_without_heights(run, result).point_covariance).all()
    air["height_verdict"] = {"spread_m": 0.7}
    path.write_text(json.dumps(summary))
    assert _without_heights(run, Result.read(run)).point_covariance[2, 2] == pytest.approx(0.49)
    air["heights"] = "NOT_CONFIRMED"
    path.write_text(json.dumps(summary))
    assert worst_errors(Result.read(run)) is None


def test_a_ray_meets_the_nearest_surface_and_a_finer_one_after_it_has_come() -> None:
    def level(height: float, name: str = "a") -> object:
        return draped(name, Grid(0.0, 10.0, 1.0, (10, 10)), np.zeros((10, 10, 3), np.uint8), np.full((10, 10), height))

    picker, down = Picker(), (0.0, 0.0, -1.0)
    low, high = level(2.0), level(5.0, "b")
    np.testing.assert_allclose(picker.hit((4.2, 5.3, 50.0), down, [low, high]), [4.2, 5.3, 5.0], atol=1e-4)  # type: ignore[list-item]
    np.testing.assert_allclose(picker.hit((4.2, 5.3, 50.0), down, [level(3.0)]), [4.2, 5.3, 3.0], atol=1e-4)  # type: ignore[list-item]
    assert picker.hit((40.0, 5.0, 50.0), down, [low]) is None  # type: ignore[list-item]
