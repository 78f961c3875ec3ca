# SPDX-License-Identifier: Apache-2.0
"""Known registrations are recovered with a realistic accuracy; scrambled matches are refused."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.errors import TooFewMatches
from skymoor.geo import EnuFrame, Grid
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.geometry import Similarity, point_covariance
from skymoor.registration import (
    Agreement,
    NullSample,
    RegisterOptions,
    camera_accuracy,
    decide,
    register,
    restated,
)
from skymoor.registration.covariance import SHAPE_FACTOR, matched_covariance
from skymoor.registration.criteria import remedy_of
from skymoor.registration.criterion_kinds import KINDS
from skymoor.types import Calibration, Camera, Matches2D, Matches3D, Reference, Registration
from support.blocks import LENS, look_at
from support.comparators import assert_similarity_near

Array = NDArray[np.float64]
TILT = Rotation.from_euler("xy", [1.2, -0.9], degrees=True)
TRUTH = Similarity(63.0, (TILT * Rotation.from_euler("z", 130, degrees=True)).as_matrix(), np.array([12.0, -25.0, 3.0]))
SIGMA_M = np.array([0.2, 0.2, 0.35])
SCORES = [100.0, 22.0, 20.0]


def planted(n: int = 800, *, outliers: float = 0.0, seed: int = 0, sigma_m: Array = SIGMA_M) -> Matches3D:
    """Matches over 90 by 90 m with up to 8 m of relief; a share of them belongs to other places."""
    rng = np.random.default_rng(seed)
    xyz_level = rng.uniform([-0.7, -0.7, -0.01], [0.7, 0.7, 0.12], (n, 3))
    xyz_enu = TRUTH.apply(xyz_level) + rng.normal(size=(n, 3)) * sigma_m
    wrong = rng.permutation(n)[: round(outliers * n)]
    xyz_enu[wrong] = rng.uniform([-60, -80, -2], [80, 40, 10], (len(wrong), 3))
    return Matches3D(xyz_level, xyz_enu, Matches2D(np.zeros((n, 2)), np.zeros((n, 2)), np.ones(n)))


def registered(matches: Matches3D, seed: int = 0, options: RegisterOptions | None = None) -> Registration:
    return register(matches, 0.5, options, rng=np.random.default_rng(seed))


@pytest.mark.parametrize("outliers", [0.0, 0.4, 0.7])
def test_a_known_registration_is_recovered(outliers: float) -> None:
    matches = planted(outliers=outliers, seed=1)
    found = registered(matches)
    assert found.registered and found.enu_from_level is not None
    assert_similarity_near(found.enu_from_level, TRUTH, rot_deg=0.3, trans_m=0.15, scale_ppm=3000)
    assert found.n_matches == 800
    # Noise beyond the gate of 1 m is rare; a few outliers lie within it by chance.
    assert (1 - outliers) * 0.93 < found.inlier_ratio < (1 - outliers) * 1.0 + 0.02
    assert 0.8 * np.linalg.norm(SIGMA_M) < found.rmse_m < 1.1 * np.linalg.norm(SIGMA_M)
    assert found.tilt_deg == pytest.approx(1.5, abs=0.25)
    decided = decide(found, SCORES, 1000, agreement=Agreement(70, 90))
    assert decided.registered and decided.reason == ""
    assert decided.diagnostics["search_score"] == 100 and decided.diagnostics["second_score"] == 22


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 53.0])
def test_matches_on_one_vertical_plane_have_an_accuracy(heading_deg: float) -> None:
    """A single wall: its matches are on a line in plan, which does not determine the slope across that line."""
    rng = np.random.default_rng(4)
    heading = np.radians(heading_deg)
    east, north = (np.round(f(heading), 2) for f in (np.sin, np.cos))
    along, up = rng.uniform(-15, 15, (2, 400)), rng.uniform(0, 9, 400)
    wall = np.column_stack([east * along[0], north * along[0], up])
    noise = rng.normal(size=(400, 2)) * [0.2, 0.35]
    target = wall + np.column_stack([east * noise[:, 0], north * noise[:, 0], noise[:, 1]])  # errors within the wall
    covariance, centre, _ = matched_covariance(
        wall, target, Similarity.identity(), sigma_m=SIGMA_M, tilt_sigma_deg=3.0, rng=rng
    )
    sigma_m = np.sqrt(np.diag(point_covariance(covariance, centre, wall.mean(axis=0))[0]))
    # Not better than 400 independent matches along the wall and up, and no worse than one match.
    assert np.hypot(sigma_m[0], sigma_m[1]) > 0.7 * 0.2 / np.sqrt(400) and sigma_m[2] > 0.7 * 0.35 / np.sqrt(400)
    assert (sigma_m < 0.35).all()
    found = registered(Matches3D(wall, target, Matches2D(np.zeros((400, 2)), np.zeros((400, 2)), np.ones(400))))
    assert found.registered and found.covariance is not None


def test_residuals_are_estimate_minus_truth() -> None:
    matches = planted(seed=2)
    found = registered(matches)
    assert found.enu_from_level is not None and found.residuals_m is not None and found.inliers is not None
    np.testing.assert_allclose(found.residuals_m, found.enu_from_level.apply(matches.xyz_level) - matches.xyz_enu)
    assert found.inliers.sum() == found.n_inliers
    # The gate: two pixels of the reference or a metre, whichever is more.
    assert np.linalg.norm(found.residuals_m[found.inliers], axis=1).max() <= 1.0
    wide = register(matches, 2.0, rng=np.random.default_rng(0))
    assert wide.n_inliers > found.n_inliers


def test_scrambled_matches_are_refused() -> None:
    for seed in range(2):
        matches = planted(400, seed=seed)
        order = np.random.default_rng(seed).permutation(400)
        scrambled = replace(matches, xyz_enu=matches.xyz_enu[order])
        assert not decide(registered(scrambled), SCORES, 1000).registered


def test_few_or_degenerate_matches_give_a_reason() -> None:
    for n in (0, 1):
        found = registered(planted(n))
        assert not found.registered and "no transform" in found.reason and found.n_matches == n
        assert not decide(found, SCORES, 1000).registered
    matches = planted(50)
    pole = replace(matches, xyz_level=matches.xyz_level * [0, 0, 1])
    assert not registered(pole).registered


def test_the_same_seed_gives_the_same_result() -> None:
    a, b = (registered(planted(outliers=0.5), seed=3) for _ in range(2))
    assert a.enu_from_level is not None and b.enu_from_level is not None
    np.testing.assert_array_equal(a.enu_from_level.matrix(), b.enu_from_level.matrix())


def test_predicted_accuracy_covers_the_error_of_many_trials() -> None:
    """Independent errors: the prediction is up to three times the textbook's, for 300 matches cannot deny that a small
    share of their errors is alike everywhere; and never less."""
    where = TRUTH.apply([[0.0, 0.0, 1.0], [0.6, -0.5, 1.0]])
    errors, predicted = [], []
    for seed in range(25):
        found = registered(planted(300, seed=seed), seed=seed)
        assert found.enu_from_level is not None and found.covariance is not None and found.centroid_enu is not None
        at = found.enu_from_level.apply(TRUTH.inverse().apply(where))
        errors.append(at - where)
        predicted.append(point_covariance(found.covariance, found.centroid_enu, where))
    mean_predicted = np.sqrt(np.mean([np.diagonal(p, axis1=1, axis2=2) for p in predicted], axis=0))
    actual = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ((actual / mean_predicted > 0.33) & (actual / mean_predicted < 1.2)).all()
    assert (actual < 0.3).all()


def test_matches_that_repeat_each_other_are_not_worth_more() -> None:
    once = planted(300, seed=4)
    again = Matches3D(
        np.tile(once.xyz_level, (10, 1)),
        np.tile(once.xyz_enu, (10, 1)),
        Matches2D(np.zeros((3000, 2)), np.zeros((3000, 2)), np.ones(3000)),
    )
    few, many = registered(once), registered(again)
    assert few.covariance is not None and many.covariance is not None
    ratio = np.sqrt(np.diag(many.covariance) / np.diag(few.covariance))
    assert ((ratio > 0.4) & (ratio < 1.25)).all()
    textbook = SIGMA_M / np.sqrt(300)  # of 3000 independent ones it would be a third of that
    shift = np.sqrt(np.diag(many.covariance)[4:]) / textbook
    assert ((shift > 0.8) & (shift < 3.0)).all()


@pytest.mark.parametrize("reach_m", [0.1, 15.0, 60.0])
def test_errors_that_are_alike_far_around_are_noticed(reach_m: float) -> None:
    """Half of the variance is alike over so far: the error of the mean is predicted, from eighteen such fields."""
    squared = []
    for seed in range(18):
        rng = np.random.default_rng([3, seed])
        matches = planted(300, seed=seed, sigma_m=SIGMA_M / np.sqrt(2))
        gap = np.linalg.norm(matches.xyz_level[:, None] - matches.xyz_level, axis=2) * TRUTH.scale
        root = np.linalg.cholesky(np.exp(-((gap / reach_m) ** 2)) + 1e-6 * np.eye(300))
        alike = root @ rng.normal(size=(300, 3)) * SIGMA_M / np.sqrt(2)
        found = registered(replace(matches, xyz_enu=matches.xyz_enu + alike), seed=seed)
        assert found.enu_from_level is not None and found.covariance is not None and found.centroid_enu is not None
        error = found.centroid_enu - TRUTH.apply(found.enu_from_level.inverse().apply(found.centroid_enu))
        squared.append(error @ np.linalg.solve(found.covariance[4:, 4:], error))
    assert 0.2 < np.mean(squared) / 3 < 1.8
    assert np.mean(np.array(squared) < 6.25) > 0.7  # of 90 %


def test_matches_without_a_height_are_no_inliers() -> None:
    matches = planted(seed=8)
    xyz_enu = matches.xyz_enu.copy()
    xyz_enu[::4, 2] = np.nan
    found = registered(replace(matches, xyz_enu=xyz_enu))
    assert found.registered and found.enu_from_level is not None and found.inliers is not None
    assert_similarity_near(found.enu_from_level, TRUTH, rot_deg=0.3, trans_m=0.15, scale_ppm=3000)
    assert not found.inliers[::4].any() and 560 < found.n_inliers <= 600


def test_a_transform_from_elsewhere_states_its_own_residuals() -> None:
    matches = planted(seed=6)
    found = registered(matches)
    assert found.enu_from_level is not None
    aside = Similarity(1.0, np.eye(3), np.array([0.3, 0.0, 0.0])) @ found.enu_from_level
    moved = restated(found, aside, matches, 1.0)
    assert moved.enu_from_level is aside
    assert moved.residuals_m is not None and found.residuals_m is not None
    np.testing.assert_allclose(moved.residuals_m - found.residuals_m, [[0.3, 0.0, 0.0]] * len(matches), atol=1e-9)
    assert moved.inliers is not None
    assert moved.n_inliers == np.count_nonzero(np.linalg.norm(moved.residuals_m, axis=1) <= 1.0)
    assert moved.rmse_m > found.rmse_m


class TestDecide:
    GOOD = registered(planted(seed=6))
    MOST = Agreement(85, 90)

    def decoys(self, *scores: float) -> list[NullSample]:
        return [NullSample(score, Agreement(9 + k, 90)) for k, score in enumerate(scores)]

    @pytest.mark.parametrize(
        ("change", "scores", "word"),
        [
            ({}, [35.0, 10.0], "match score 35 is below"),
            ({}, [35.0], "match score 35 is below"),
            ({}, [100.0, 90.0], "a competing hypothesis scores 90, the best 100; at least 117"),
            ({}, [60.0, 100.0], "a competing hypothesis scores 100"),
            ({"n_inliers": 49, "n_matches": 100}, SCORES, "49 matches"),
            ({"tilt_deg": 10.5}, SCORES, "10.5°"),
        ],
    )
    def test_each_reason(self, change: dict[str, object], scores: list[float], word: str) -> None:
        decided = decide(replace(self.GOOD, **change), scores, 1000, agreement=self.MOST)  # type: ignore[arg-type]
        assert not decided.registered and word in decided.reason
        (failed,) = [one for one in decided.criteria if not one.passed]
        assert remedy_of({"criteria": [asdict(one) for one in decided.criteria]}) == KINDS[failed.kind].remedy

    def test_good_is_good_and_one_place_needs_no_second(self) -> None:
        assert decide(self.GOOD, SCORES, 1000, agreement=self.MOST).registered
        assert decide(self.GOOD, [100.0], 1000, agreement=self.MOST).registered

    def test_few_cells_are_too_few_whatever_the_share(self) -> None:
        decided = decide(self.GOOD, SCORES, 1000, agreement=Agreement(9, 9))
        assert not decided.registered and "9 independent cells" in decided.reason
        assert decide(self.GOOD, SCORES, 1000, agreement=Agreement(10, 12)).registered

    def test_the_score_must_be_significantly_above_decoys(self) -> None:
        """Three times their score is significant; a third more is not."""
        good = decide(self.GOOD, SCORES, 1000, agreement=self.MOST, decoys=self.decoys(30.0, 33.0, 28.0, 31.0))
        assert good.registered and 0 < good.diagnostics["false_alarm_probability"] < 1e-3
        assert good.diagnostics["decoy_score"] == 33
        some, decoys = Agreement(30, 90), self.decoys(45.0, 50.0, 42.0, 46.0)
        poor = decide(self.GOOD, [60.0, 30.0], 1000, agreement=some, decoys=decoys)
        assert not poor.registered and "decoys reach 50 and 12 in this reference" in poor.reason

    def test_agreement_makes_up_for_a_score_that_decoys_nearly_reach(self) -> None:
        decoys = self.decoys(45.0, 50.0, 42.0, 46.0)
        assert decide(self.GOOD, [60.0, 30.0], 1000, agreement=Agreement(89, 90), decoys=decoys).registered

    def test_a_score_without_agreement_is_refused(self) -> None:
        """As at a place that looks alike in the large and in nothing else."""
        decided = decide(
            self.GOOD, SCORES, 1000, agreement=Agreement(14, 90), decoys=self.decoys(30.0, 33.0, 28.0, 31.0)
        )
        assert not decided.registered and "matches agree in 14 of 90 independent cells" in decided.reason

    def test_a_low_score_is_enough_where_decoys_stay_far_below(self) -> None:
        few, many = self.decoys(12.0, 13.0, 11.0, 12.0), self.decoys(24.0, 26.0, 22.0, 24.0)
        found = decide(self.GOOD, [30.0, 10.0], 1000, agreement=self.MOST, decoys=few)
        assert found.registered and "match_score" not in {one.kind for one in found.criteria}
        assert not decide(self.GOOD, [30.0, 10.0], 1000, agreement=Agreement(30, 90), decoys=many).registered

    def test_thresholds_are_options(self) -> None:
        strict, mild = RegisterOptions(min_score=101.0), RegisterOptions(min_score=20.0, min_score_margin=1.1)
        decoys = self.decoys(12.0, 13.0, 11.0, 12.0)
        for null in ((), decoys):
            assert not decide(self.GOOD, SCORES, 1000, strict, agreement=self.MOST, decoys=null).registered
        assert decide(self.GOOD, [30.0, 25.0], 9, mild, agreement=self.MOST, decoys=decoys).registered
        assert not decide(self.GOOD, [30.0, 25.0], 9, agreement=self.MOST, decoys=decoys).registered


class TestCameraAccuracy:
    REFERENCE = Reference(
        EnuFrame(47.0, 8.0, 400.0),
        Grid(0.0, 0.0, 0.5, (10, 10)),
        np.zeros((10, 10, 3), np.uint8),
        np.ones((10, 10), bool),
        np.zeros((10, 10), np.float32),
        np.diag([1.7, 1.7, 5.4]),
        0.5,
    )

    def cameras(self) -> list[Camera]:
        centres = ([12.0, -25.0, 63.0], [12.0, -25.0, 103.0])
        return [Camera("", LENS, look_at(np.array(c), np.zeros(3))) for c in centres]

    def centres(self) -> Array:
        return np.array([camera.centre for camera in self.cameras()])

    def test_reference_and_registration_add_up(self) -> None:
        found = registered(planted(seed=7))
        accuracy = camera_accuracy(found, self.centres(), self.REFERENCE, None)
        np.testing.assert_array_equal(accuracy.shared, [self.REFERENCE.covariance] * 2)
        own = accuracy.relative
        assert (np.linalg.eigvalsh(own) > 0).all()
        assert (np.sqrt(np.diagonal(own, axis1=1, axis2=2)) < 0.4).all()
        np.testing.assert_allclose(own, own.transpose(0, 2, 1), atol=1e-12)
        np.testing.assert_allclose(accuracy.total, accuracy.shared + own)

    def test_an_uncertain_focal_length_is_height(self) -> None:
        found = registered(planted(seed=7))
        assert found.centroid_enu is not None
        half = 0.05 * LE90_PER_SIGMA
        calibration = Calibration(True, 392.0, 0.0001, 1 - half, 1 + half, True)
        without, with_focal = (
            camera_accuracy(found, self.centres(), self.REFERENCE, c).relative for c in (None, calibration)
        )
        added = np.sqrt((with_focal - without)[:, 2, 2])
        np.testing.assert_allclose(added, 0.05 * (np.array([63.0, 103.0]) - found.centroid_enu[2]), rtol=1e-6)
        np.testing.assert_allclose(with_focal[:, :2], without[:, :2])

    def test_an_uncertain_shape_is_added(self) -> None:
        found = registered(planted(seed=7))
        shape = np.array([np.diag([0.1, 0.2, 0.3]), np.zeros((3, 3))]) ** 2
        without, with_shape = (
            camera_accuracy(found, self.centres(), self.REFERENCE, None, s).relative for s in (None, shape)
        )
        np.testing.assert_allclose(with_shape - without, SHAPE_FACTOR**2 * shape, atol=1e-12)

    def test_an_unregistered_model_has_none(self) -> None:
        nothing = Registration(registered=False, reason="", enu_from_level=None)
        with pytest.raises(TooFewMatches):
            camera_accuracy(nothing, self.centres(), self.REFERENCE, None)
