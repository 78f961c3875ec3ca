# SPDX-License-Identifier: Apache-2.0
"""Hypotheses of several walls are pooled, and weak or doubtful ones are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.ground.walls import AcceptanceOptions, RefinedHypothesis, WallHypothesis, decide_ground, pool_hypotheses
from skymoor.ground.walls.consensus import unusual_height
from skymoor.registration import independent_cells
from skymoor.types import Registration

PROBES = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 3.0]])


def moved(east_m: float) -> Similarity:
    return Similarity(1.0, np.eye(3), np.array([east_m, 0.0, 0.0]))


def candidate(
    score: float,
    east_m: float = 0.0,
    cells: int = 120,
    perturbed: tuple[float, ...] = (8.0, 12.0),
    plan_score: float = 10.0,
) -> RefinedHypothesis:
    found = Registration(True, "", moved(east_m), n_matches=200, n_inliers=150, tilt_deg=1.0)
    origin = WallHypothesis(moved(east_m), 0, 0, 30.0)
    seen = (score, 0.5, 2, 1.6, 0.0, cells, perturbed, plan_score)
    return RefinedHypothesis(origin, found, moved(east_m), *seen)


def elsewhere(east_m: float) -> RefinedHypothesis:
    """Of another place, as chance makes it."""
    return candidate(30, east_m=east_m, cells=15, plan_score=5.0)


def test_two_walls_that_agree_beat_a_better_one_that_stands_alone() -> None:
    hypotheses = [
        WallHypothesis(moved(90), 0, 5, 30.0),
        WallHypothesis(moved(0), 0, 1, 25.0),
        WallHypothesis(moved(1), 1, 2, 24.0),
    ]
    best, other = pool_hypotheses(hypotheses, PROBES)
    assert best.enu_from_level.translation[0] < 2
    assert best.support == 2
    assert best.score == pytest.approx(np.hypot(25, 24))
    assert other.score == pytest.approx(30)


def test_two_hypotheses_of_one_wall_are_one_observation() -> None:
    hypotheses = [WallHypothesis(moved(0), 0, 1, 25.0), WallHypothesis(moved(1), 0, 1, 24.0)]
    (only,) = pool_hypotheses(hypotheses, PROBES)
    assert (only.support, only.score) == (1, pytest.approx(25.0))
    assert pool_hypotheses([], PROBES) == []


def test_a_good_hypothesis_is_accepted_with_its_margin() -> None:
    found = decide_ground([candidate(60), candidate(58, east_m=1.0), elsewhere(50)], PROBES)
    assert found.registered
    # The hypothesis beside the best one is the same.
    assert found.diagnostics["second_score"] == 30
    assert found.diagnostics["cells"] == 120
    assert decide_ground([candidate(60)], PROBES).registered


def test_the_contrast_is_the_excess_over_perturbed_positions() -> None:
    # 60 against 8 and 12: 50 more than their mean, whose standard deviation is 2.
    assert candidate(60).contrast == pytest.approx(50 / np.sqrt(2))
    assert candidate(60, perturbed=(50.0, 70.0)).contrast == 0
    assert candidate(5).contrast == 0
    assert candidate(60, perturbed=()).contrast == 0
    found = decide_ground([candidate(60), candidate(50, east_m=60, plan_score=5.0)], PROBES)
    assert found.diagnostics["contrast"] == pytest.approx(50 / np.sqrt(2))
    assert found.diagnostics["second_contrast"] == pytest.approx(40 / np.sqrt(2))


def test_key_points_order_places_and_do_not_decide() -> None:
    plain = candidate(25, cells=30)
    seen = replace(plain, key_point_cells=60)
    gain = 1.24 * np.log(61)
    assert (seen.odds - plain.odds, seen.evidence - plain.evidence) == (pytest.approx(gain), pytest.approx(gain))
    assert replace(plain, key_point_cells=0).odds == plain.odds
    # Facades that are alike from both sides have them at a mirror image, too.
    assert seen.likelihood == plain.likelihood
    found = decide_ground([replace(elsewhere(60), key_point_cells=4), seen], PROBES)
    assert not found.registered and found.diagnostics["key_point_cells"] == 60
    assert "key_point_cells" not in decide_ground([plain], PROBES).diagnostics


@pytest.mark.parametrize(
    ("candidates", "word"),
    [
        ([], "no wall"),
        ([candidate(25, plan_score=4.0)], "a wrong place agrees as well"),
        ([candidate(25, cells=30)], "a wrong place agrees as well"),
        ([candidate(25, plan_score=float("nan"))], "a wrong place agrees as well"),
        ([candidate(12, plan_score=14.0)], "contrast 1.4 of the agreement"),
        ([candidate(50), candidate(48, east_m=60.0, cells=90)], "another place is nearly as likely"),
        ([candidate(60, cells=3, plan_score=25.0)], "inliers lie in 3 independent cells"),
        ([replace(candidate(60), height_m=9.0)], "is 9 m; at most 8 m"),
        ([replace(candidate(60), blocked=0.9)], "90 % of the viewing rays"),
        ([replace(candidate(60), registration=Registration(False, "open", None))], "open"),
    ],
)
def test_doubtful_hypotheses_are_refused_with_their_reason(candidates: list[RefinedHypothesis], word: str) -> None:
    found = decide_ground(candidates, PROBES)
    assert not found.registered
    assert word in found.reason


def test_what_is_impossible_does_not_compete() -> None:
    in_the_air = replace(candidate(70, east_m=80), height_m=12.0)
    through_walls = replace(candidate(65, east_m=40), blocked=0.4)
    found = decide_ground([in_the_air, through_walls, candidate(60)], PROBES)
    assert found.registered
    assert found.enu_from_level is not None
    assert found.enu_from_level.translation[0] == 0
    assert found.diagnostics["second_contrast"] == 0


def test_few_inliers_and_tilt_are_refused() -> None:
    best = candidate(60)
    few = replace(best, registration=replace(best.registration, n_inliers=10))
    tilted = replace(best, registration=replace(best.registration, tilt_deg=12.0))
    assert "inlier ratio" in decide_ground([few], PROBES).reason
    assert "tilted by 12°" in decide_ground([tilted], PROBES, AcceptanceOptions(max_tilt_deg=5.0)).reason


def test_neighbouring_matches_are_one_cell() -> None:
    plan = np.array([[0.1, 0.1], [9.0, 9.0], [10.1, 0.1], [-0.1, 0.1]])
    assert independent_cells(plan, 10.0) == 3
    xyz = np.array([[0.1, 0.1, 0.1], [0.2, 0.3, 0.4], [0.1, 0.1, 5.0]])
    assert independent_cells(xyz, 2.0) == 2
    assert independent_cells(np.zeros((0, 3)), 2.0) == 0


def test_order_and_likelihood_of_hypotheses() -> None:
    plain = candidate(40, plan_score=6.0)
    # Before matching: contrast and agreement in plan, less for a height that is unusual.
    assert candidate(60, plan_score=6.0).evidence > plain.evidence
    assert replace(plain, perturbed_scores=()).evidence < plain.evidence
    assert replace(plain, plan_score=8.0).evidence > plain.evidence
    assert replace(plain, height_m=5.0).evidence < plain.evidence
    # After it: agreement in plan and the cells of the matches.
    assert replace(plain, plan_score=8.0).likelihood > plain.likelihood
    assert replace(plain, cells=240).likelihood == pytest.approx(plain.likelihood + 1.24 * np.log(241 / 121))
    assert replace(plain, score=80.0).likelihood == pytest.approx(plain.likelihood + 0.1 * 40 / np.sqrt(2))
    # What is not known in plan, and what contradicts there, is no evidence.
    assert replace(plain, plan_score=-4.0).likelihood == replace(plain, plan_score=float("nan")).likelihood
    unmatched = replace(plain, registration=Registration(False, "", None))
    assert unmatched.likelihood == pytest.approx(0.42 * 6.0 + 0.1 * plain.contrast)
    assert unmatched.odds == unmatched.evidence == plain.evidence < plain.odds


def test_what_a_height_takes_off_is_its_prior() -> None:
    usual, double, half, unknown = unusual_height(np.array([1.7, 3.4, 0.85, np.nan]))
    assert (usual, unknown) == (0.0, 0.0)
    assert double == pytest.approx(half)
    assert double == pytest.approx((np.log(2) / 0.5) ** 2 / 2)


def test_the_chance_of_the_likelihood_is_that_of_the_decoys() -> None:
    def chance(cells: int, plan_score: float) -> float:
        found = decide_ground([candidate(20, cells=cells, plan_score=plan_score), elsewhere(60)], PROBES)
        return next(one.value for one in found.criteria if one.kind == "chance_of_evidence")

    assert chance(25, 4.0) == pytest.approx(0.14, abs=0.05)  # about the mean of wrong ones
    assert chance(100, 10.0) < chance(60, 8.0) < chance(25, 4.0)
    assert chance(120, 11.0) < 0.01 < chance(60, 8.0)
    assert chance(300, 20.0) < 1e-4


def test_a_place_must_be_more_likely_than_any_other() -> None:
    rival = candidate(60, east_m=60.0, cells=20)
    found = decide_ground([candidate(60), rival], PROBES)
    ratio = next(one.value for one in found.criteria if one.kind == "likelihood_ratio")
    assert ratio == pytest.approx((121 / 21) ** 1.24, rel=1e-6)
    assert not found.registered
    assert decide_ground([candidate(60), replace(rival, cells=10)], PROBES).registered
