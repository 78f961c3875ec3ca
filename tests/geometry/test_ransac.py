# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity, gauge_centre, point_covariance, ransac_similarity
from skymoor.geometry.adjust import Loss
from skymoor.geometry.ransac import refine_similarity, tilt_deg
from support.comparators import assert_similarity_near

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIGMA_M = 0.3
N = 500


def similarity(
    heading_deg: float, tilt: float = 0.0, translation: tuple[float, float, float] = (50, -20, 7)
) -> Similarity:
    rotation = Rotation.from_euler("zyx", [heading_deg, tilt, 0.0], degrees=True).as_matrix()
    return Similarity(4.0, rotation, np.array(translation, dtype=np.float64))


def matches(
    truth: Similarity, rng: np.random.Generator, outliers: float = 0.7, n: int = N, sigma: float = SIGMA_M
) -> tuple[Array, Array, Mask]:
    """Correspondences of which a share is anywhere in the site; inliers carry noise."""
    source = rng.uniform(-1, 1, (n, 3)) * [25, 25, 3]
    target = truth.apply(source) + rng.normal(size=(n, 3)) * sigma
    wrong = np.zeros(n, dtype=bool)
    wrong[: int(outliers * n)] = True
    target[wrong] = truth.apply(rng.permutation(source[wrong]))
    return source, target, ~wrong


def rms_error_m(fitted: Similarity, truth: Similarity, source: Array) -> float:
    return float(np.sqrt(np.mean(np.sum((fitted.apply(source) - truth.apply(source)) ** 2, axis=1))))


@pytest.mark.parametrize("level", [True, False])
@pytest.mark.parametrize("translation", [(50, -20, 7), (512_345, 5_212_345, 432)])
def test_seventy_percent_outliers(level: bool, translation: tuple[float, float, float]) -> None:
    truth = similarity(200.0, 0.0 if level else 35.0, translation)
    errors = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        source, target, right = matches(truth, rng)
        result = ransac_similarity(source, target, inlier_m=1.2, rng=rng, level=level)
        errors.append(rms_error_m(result.transform, truth, source))
        assert result.inliers[right].mean() > 0.98
        assert result.inliers[~right].mean() < 0.05
    # Seven parameters of 150 good matches: sigma * sqrt(7 / 150), plus a little for the few wrong ones accepted.
    expected = SIGMA_M * np.sqrt(7 / (0.3 * N))
    assert 0.5 * expected < np.sqrt(np.mean(np.square(errors))) < 1.5 * expected


def test_recovers_a_tilt_that_the_level_hypotheses_lack() -> None:
    truth = similarity(200.0, 0.6)
    rng = np.random.default_rng(1)
    source, target, _ = matches(truth, rng)
    result = ransac_similarity(source, target, inlier_m=1.2, rng=rng)
    assert 0.5 < tilt_deg(result.transform) < 0.7


def test_same_generator_same_result() -> None:
    source, target, _ = matches(similarity(10.0), np.random.default_rng(2))
    a, b = (ransac_similarity(source, target, inlier_m=1.0, rng=np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a.transform.matrix(), b.transform.matrix())
    np.testing.assert_array_equal(a.inliers, b.inliers)
    assert a.n_trials == b.n_trials


def test_trials_adapt_to_the_inliers() -> None:
    truth, trials = similarity(10.0), []
    for share in (0.0, 0.95):
        rng = np.random.default_rng(3)
        source, target, _ = matches(truth, rng, outliers=share)
        trials.append(ransac_similarity(source, target, inlier_m=1.2, rng=rng, max_trials=6000).n_trials)
    assert trials[0] < 600
    assert 2000 < trials[1] <= 6000


def test_scale_limits() -> None:
    rng = np.random.default_rng(4)
    source, target, right = matches(similarity(10.0), rng, outliers=0.3)
    result = ransac_similarity(source, target, inlier_m=1.2, rng=rng, min_scale=4.5, max_scale=6.0)
    assert 4.5 <= result.transform.scale <= 6.0
    assert result.inliers.sum() < 0.5 * right.sum()


def test_few_matches_and_degenerate_ones() -> None:
    rng = np.random.default_rng(5)
    source, target, _ = matches(similarity(10.0), rng, outliers=0.0, sigma=0.0)
    exact = ransac_similarity(source[:2], target[:2], inlier_m=1.0, rng=rng)
    assert_similarity_near(exact.transform, similarity(10.0), rot_deg=1e-6, trans_m=1e-9, scale_ppm=1e-6)
    with pytest.raises(TooFewMatches):
        ransac_similarity(source[:1], target[:1], inlier_m=1.0, rng=rng)
    with pytest.raises(TooFewMatches):
        ransac_similarity(source[:2], target[:2], inlier_m=1.0, rng=rng, level=False)
    pole = np.zeros((30, 3))
    pole[:, 2] = np.arange(30)
    for level in (True, False):
        with pytest.raises(DegenerateGeometry):
            ransac_similarity(pole, pole, inlier_m=1.0, rng=rng, level=level, max_trials=1000)
    with pytest.raises(DegenerateGeometry, match="finite"):
        ransac_similarity(source * [1, 1, np.nan], target, inlier_m=1.0, rng=rng)


def error_of(truth: Similarity, fitted: Similarity, centre: Array) -> Array:
    """The seven parameters that carry the fitted transform to the true one, in the documented gauge."""
    change = truth @ fitted.inverse()
    rotvec = Rotation.from_matrix(change.rotation).as_rotvec()
    return np.concatenate([[np.log(change.scale)], rotvec, change.apply(centre) - centre])


def mean_normalised_square(
    loss: Loss, *, outliers: float = 0.0, promised: float = 1.0, trials: int = 200, n: int = 80
) -> float:
    """Mean squared error over its covariance, 7 where the covariance is right. Noise is `promised` times sigma_m."""
    rng, truth, sigma = np.random.default_rng(6), similarity(70.0, 0.5), np.array([0.2, 0.2, 0.6])
    squares = []
    for _ in range(trials):
        source, target, _ = matches(truth, rng, outliers=outliers, n=n, sigma=0.0)
        target += rng.normal(size=target.shape) * sigma * promised
        fitted, covariance, weights = refine_similarity(source, target, truth, sigma_m=sigma, loss=loss)
        error = error_of(truth, fitted, gauge_centre(fitted, source, weights))
        squares.append(error @ np.linalg.solve(covariance, error))
    return float(np.mean(squares))


@pytest.mark.parametrize(
    ("loss", "outliers", "promised"),
    [("tukey", 0.0, 1.0), ("huber", 0.0, 1.0), ("tukey", 0.4, 1.0), ("tukey", 0.0, 1.7)],
)
def test_covariance_is_calibrated(loss: Loss, outliers: float, promised: float) -> None:
    # The mean of 200 chi-squares with 7 degrees of freedom scatters by sqrt(14 / 200) = 0.26 about 7; where the noise
    # is as promised, the floor of the variance factor makes it a little smaller.
    assert 5.8 < mean_normalised_square(loss, outliers=outliers, promised=promised) < 7.9


def test_covariance_keeps_the_promised_floor() -> None:
    assert 7 * 0.5**2 * 0.8 < mean_normalised_square("tukey", promised=0.5) < 7 * 0.5**2 * 1.2


def test_covariance_at_a_point_is_that_of_its_errors() -> None:
    rng, truth = np.random.default_rng(7), similarity(70.0, 0.5)
    place = np.array([[150.0, -80.0, 40.0]])
    errors, promised = [], []
    for _ in range(200):
        source, target, _ = matches(truth, rng, outliers=0.0, n=60)
        fitted, covariance, weights = refine_similarity(source, target, truth, sigma_m=SIGMA_M)
        centre = gauge_centre(fitted, source, weights)
        promised.append(point_covariance(covariance, centre, place)[0])
        errors.append(fitted.apply(truth.inverse().apply(place))[0] - place[0])
    ratio = np.sum(np.square(errors), axis=0) / np.sum([np.diag(c) for c in promised], axis=0)
    assert ((ratio > 0.7) & (ratio < 1.3)).all()


def test_refinement_converges() -> None:
    rng, truth = np.random.default_rng(8), similarity(70.0, 0.5)
    source, target, right = matches(truth, rng, outliers=0.3)
    start = similarity(70.5, 0.2, translation=(50.4, -20.3, 7.2))
    fitted, _, weights = refine_similarity(source, target, start, sigma_m=SIGMA_M)
    assert rms_error_m(start, truth, source) > 0.5
    assert 0.2 < rms_error_m(fitted, truth, source) / (SIGMA_M * np.sqrt(7 / right.sum())) < 2.0
    assert weights.shape == (N,)
    assert weights[right].mean() > 0.75
    assert weights[~right].mean() < 0.05


def test_sigma_of_each_axis_weighs_it() -> None:
    # Source in a vertical plane, of which heights are worthless: the plan alone must give the scale.
    rng, truth = np.random.default_rng(9), similarity(0.0)
    source, target, _ = matches(truth, rng, outliers=0.0, sigma=0.0)
    target[:, 2] += 0.02 * (target[:, 2] - 7.0)
    fitted, _, _ = refine_similarity(source, target, truth, sigma_m=[0.01, 0.01, 10.0], loss="huber")
    assert fitted.scale == pytest.approx(4.0, rel=1e-5)


def test_tilt_prior_holds_what_the_points_leave_open() -> None:
    truth = similarity(30.0)
    line = np.column_stack([np.linspace(-20, 20, 30), np.zeros(30), np.zeros(30)])
    target = truth.apply(line)
    with pytest.raises(DegenerateGeometry):
        refine_similarity(line, target, truth, sigma_m=0.1)
    fitted, covariance, _ = refine_similarity(line, target, truth, sigma_m=0.1, tilt_sigma_deg=2.0)
    assert_similarity_near(fitted, truth, rot_deg=1e-6, trans_m=1e-6, scale_ppm=1e-3)
    along = truth.rotation[:, 0]
    assert np.degrees(np.sqrt(along @ covariance[1:4, 1:4] @ along)) == pytest.approx(2.0, rel=1e-3)


def test_tilt_prior_and_data_share_by_their_weights() -> None:
    truth = similarity(0.0, 3.0)
    source, target, _ = matches(truth, np.random.default_rng(10), outliers=0.0, sigma=0.0)
    free, covariance, _ = refine_similarity(source, target, truth, sigma_m=20.0)
    sigma_deg = float(np.degrees(np.sqrt(covariance[2, 2])))
    held, _, _ = refine_similarity(source, target, truth, sigma_m=20.0, tilt_sigma_deg=sigma_deg)
    assert tilt_deg(free) == pytest.approx(3.0, rel=1e-4)
    # Equal trust in data and prior, up to the few percent that the covariance adds for the robust loss.
    assert 1.35 < tilt_deg(held) < 1.65


def test_refinement_needs_correspondences_near_the_start() -> None:
    source, target, _ = matches(similarity(30.0), np.random.default_rng(11), outliers=0.0)
    with pytest.raises(TooFewMatches, match="agree"):
        refine_similarity(source, target + [0, 0, 100], similarity(30.0), sigma_m=SIGMA_M)


def test_tilt_deg() -> None:
    assert tilt_deg(similarity(123.0)) == pytest.approx(0.0, abs=1e-9)
    assert tilt_deg(similarity(123.0, 1e-4)) == pytest.approx(1e-4, rel=1e-6)
    assert tilt_deg(similarity(123.0, 180.0)) == pytest.approx(180.0)
