# SPDX-License-Identifier: Apache-2.0
"""Place and heights come from different evidence: a bad elevation model moves nothing in plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity, point_covariance
from skymoor.registration import HeightFit, fit_plan, flat_transform, judge_heights, place_on_map
from skymoor.types import HeightVerdict, Matches2D, Matches3D, Registration

Array = NDArray[np.float64]
TRUTH = Similarity(63.0, Rotation.from_euler("z", 130, degrees=True).as_matrix(), np.array([12.0, -25.0, 3.0]))
CAMERAS = TRUTH.apply([[0.0, 0.0, 1.0], [0.5, -0.4, 1.1]])


def planted(tilt_deg: tuple[float, float] = (0.0, 0.0), n: int = 600, seed: int = 0) -> Matches3D:
    """Matches of a model that was levelled with an error of `tilt_deg` about east and north; 0.2 m of noise in plan."""
    rng = np.random.default_rng(seed)
    right = rng.uniform([-0.7, -0.7, -0.01], [0.7, 0.7, 0.06], (n, 3))
    wrong = Rotation.from_euler("xy", tilt_deg, degrees=True).as_matrix()
    level = right @ (TRUTH.rotation.T @ wrong.T @ TRUTH.rotation).T
    enu = TRUTH.apply(right) + rng.normal(size=(n, 3)) * [0.2, 0.2, 0.0]
    return Matches3D(level, enu, Matches2D(np.zeros((n, 2)), np.zeros((n, 2)), np.ones(n)))


def height_fit(matches: Matches3D, **change: object) -> HeightFit:
    """What a comparison with the true surface finds."""
    plan = matched(matches)
    model = flat_transform(plan).apply(matches.xyz_level)
    centre = model.mean(axis=0)
    design = np.column_stack([model[:, :2] - centre[:2], np.ones(len(model))])
    slope_east, slope_north, offset = np.linalg.lstsq(design, matches.xyz_enu[:, 2] - model[:, 2], rcond=None)[0]
    covariance = np.diag([0.001**2, 0.001**2, 0.05**2, 0.02**2])
    slope = np.array([slope_east, slope_north])
    found = HeightFit(1.0, float(offset), slope, covariance, centre, 0.2, 2.0, 2.0, 2.4, 60)
    return replace(found, **change)  # type: ignore[arg-type]


def matched(matches: Matches3D):  # type: ignore[no-untyped-def]
    none = np.zeros(len(matches))
    rng = np.random.default_rng(0)
    return fit_plan(matches.xyz_level[:, :2], matches.xyz_enu[:, :2], none, inlier_m=1.0, rng=rng)


def placed(matches: Matches3D, heights: HeightFit | None, tilt_sigma_deg: float = 1.0) -> Registration:
    verdict = judge_heights(heights, None)
    none, rng = np.zeros(len(matches)), np.random.default_rng(1)
    plan = matched(matches)
    return place_on_map(matches, plan, heights, verdict, none, tilt_sigma_deg=tilt_sigma_deg, rng=rng)


def errors(found: Registration, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> Array:
    assert found.enu_from_level is not None
    wrong = Rotation.from_euler("xy", tilt_deg, degrees=True).as_matrix()
    level = TRUTH.inverse().apply(CAMERAS) @ (TRUTH.rotation.T @ wrong.T @ TRUTH.rotation).T
    return found.enu_from_level.apply(level) - CAMERAS


def test_confirmed_heights_correct_the_levelling() -> None:
    tilt = (1.2, -0.9)
    matches = planted(tilt)
    found = placed(matches, height_fit(matches))
    assert found.heights is not None and found.heights.status == "CONFIRMED"
    assert found.tilt_deg == pytest.approx(1.5, abs=0.05)
    assert np.abs(errors(found, tilt)).max() < 0.12
    assert found.covariance is not None and found.centroid_enu is not None
    sigma = np.sqrt(np.diagonal(point_covariance(found.covariance, found.centroid_enu, CAMERAS), axis1=1, axis2=2))
    assert (sigma < 0.12).all()


def test_without_heights_the_levelling_stays_and_its_error_is_stated() -> None:
    tilt = (1.2, -0.9)
    matches = planted(tilt)
    found = placed(replace(matches, xyz_enu=matches.xyz_enu * [1, 1, np.nan]), None)
    assert found.registered and found.heights is not None and found.heights.status == "NOT_CONFIRMED"
    assert found.tilt_deg == pytest.approx(0.0, abs=1e-6)
    off = errors(found, tilt)
    # 60 m above ground, 1.5 degrees are 1.6 m.
    assert 0.9 < np.hypot(off[0, 0], off[0, 1]) < 2.2
    assert found.covariance is not None and found.centroid_enu is not None
    covariance = point_covariance(found.covariance, found.centroid_enu, CAMERAS)[:, :2, :2]
    squared = [e @ np.linalg.solve(c, e) for e, c in zip(off[:, :2], covariance, strict=True)]
    assert max(squared) < 6


@pytest.mark.parametrize(
    "change",
    [
        {"scale": 3.28, "offset_m": 140.0, "slope": np.array([0.05, 0.0])},  # feet
        {"scale": 0.0, "reference_relief_m": 0.0, "slope": np.array([0.04, 0.03]), "spread_m": 4.0},  # flat
        {"scale": float("nan"), "covariance": np.diag([np.inf, np.inf, 4.0, np.inf]), "spread_m": 2.0},
    ],
)
def test_a_bad_elevation_model_moves_nothing_in_plan(change: dict[str, object]) -> None:
    matches = planted()
    good, bad = placed(matches, height_fit(matches)), placed(matches, height_fit(matches, **change))
    assert bad.heights is not None and bad.heights.status != "CONFIRMED"
    assert np.abs(errors(bad)[:, :2] - errors(good)[:, :2]).max() < 0.15
    assert bad.n_inliers == pytest.approx(good.n_inliers, abs=5)


def test_a_coarse_elevation_model_widens_heights_by_what_it_differs() -> None:
    matches = planted()
    fine = placed(matches, height_fit(matches))
    coarse = placed(matches, height_fit(matches, resolution_m=35.0, spread_m=2.0))
    assert fine.covariance is not None and coarse.covariance is not None
    assert np.sqrt(fine.covariance[6, 6]) < 0.1
    assert 2.0 < np.sqrt(coarse.covariance[6, 6]) < 2.2


def test_predicted_errors_are_those_of_many_trials() -> None:
    """Levelling errors drawn from their sigma, height slopes from theirs: squared errors over predicted variances."""
    squared = []
    rng = np.random.default_rng(5)
    for seed in range(40):
        tilt = tuple(rng.normal(size=2))
        matches = planted(tilt, 300, seed)
        clean = height_fit(matches)
        sigma = 0.012
        noise = rng.normal(size=2) * sigma
        covariance = np.diag([sigma**2, sigma**2, 0.05**2, 0.02**2])
        heights = replace(clean, slope=clean.slope + noise, covariance=covariance)
        found = placed(matches, heights)
        assert found.covariance is not None and found.centroid_enu is not None
        covariances = point_covariance(found.covariance, found.centroid_enu, CAMERAS)
        off = errors(found, tilt)
        squared.append([e[:2] @ np.linalg.solve(c[:2, :2], e[:2]) / 2 for e, c in zip(off, covariances, strict=True)])
    assert 0.5 < np.mean(squared) < 1.6


def test_the_verdict_comes_along() -> None:
    found = placed(planted(), None)
    assert found.heights == HeightVerdict("NOT_CONFIRMED", "the reference has no heights here")
