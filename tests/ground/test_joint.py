# SPDX-License-Identifier: Apache-2.0
"""Joint decision: the surface of one component must not lie in the observed free space of another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity
from skymoor.ground import OneHypothesis, conflict, decide_jointly
from skymoor.ground.walls import (
    AcceptanceOptions,
    RefinedHypothesis,
    WallHypotheses,
    WallHypothesis,
    transformed_depth_map,
)
from skymoor.types import Array, DepthMap, Registration
from support.houses import centres, houses, walk_round

WORLD = houses(1)
HERE = Similarity.identity()


def shown(maps: Sequence[DepthMap]) -> Array:
    return np.concatenate([m.points(step=6)[0] for m in maps]).astype(np.float64)


def share(a: Sequence[DepthMap], enu_from_a: Similarity, b: Sequence[DepthMap], enu_from_b: Similarity) -> float:
    return conflict(shown(a), a, enu_from_a, shown(b), b, enu_from_b)


def into_the_way() -> Similarity:
    """The second house in the free space of the first model's cameras."""
    cameras = centres(walk_round(WORLD, 0))[:, :2].mean(axis=0)
    aside = 0.3 * WORLD.middle[0] + 0.7 * cameras - WORLD.middle[1]
    return Similarity(1.0, np.eye(3), np.array([*aside, 0.0]))


def hypotheses(*candidates: tuple[float, Similarity]) -> WallHypotheses:
    found = [Registration(True, "", place, n_matches=200, n_inliers=150, tilt_deg=1.0) for _, place in candidates]
    ranked = [
        RefinedHypothesis(
            WallHypothesis(place, 0, 0, 30.0), registration, place, score, 0.5, 2, 1.6, 0.0, 200, (8.0, 12.0), score / 6
        )
        for registration, (score, place) in zip(found, candidates, strict=True)
    ]
    return WallHypotheses(tuple(ranked), centres(walk_round(WORLD, 1)), {"guesses": 3.0}, AcceptanceOptions())


@pytest.fixture(scope="module")
def first() -> list[DepthMap]:
    return walk_round(WORLD, 0)


@pytest.fixture(scope="module")
def second() -> list[DepthMap]:
    return walk_round(WORLD, 1)


def test_models_that_stand_right_do_not_contradict_each_other(first: list[DepthMap], second: list[DepthMap]) -> None:
    assert share(first, HERE, second, HERE) < 0.05
    # The same walls from other places.
    assert share(first[::2], HERE, walk_round(WORLD, 0, count=5), HERE) < 0.05


def test_a_house_in_the_free_space_of_another_model_is_a_contradiction(
    first: list[DepthMap], second: list[DepthMap]
) -> None:
    assert share(second, into_the_way(), first, HERE) > 0.6
    assert share(first, HERE, second, into_the_way()) > 0.6


def test_few_points_in_front_of_a_wall_that_both_show_are_no_contradiction(
    first: list[DepthMap], second: list[DepthMap]
) -> None:
    """As those far from the cameras of a small component are, though they are all that the other should see of it."""
    beside = walk_round(WORLD, 0, count=5)
    stray, confirmed = into_the_way().apply(shown(second)), shown(first)
    few = stray[:: len(stray) // 2000]
    assert conflict(few, beside, HERE, confirmed[:0], first, HERE) > 0.6
    assert 0 < conflict(few, beside, HERE, confirmed, first, HERE) < 0.2
    assert conflict(np.repeat(stray, 8, axis=0), beside, HERE, confirmed, first, HERE) > 0.5


def test_the_unit_of_a_model_does_not_matter(first: list[DepthMap], second: list[DepthMap]) -> None:
    level_from_enu = Similarity(1 / 1.7, Rotation.from_euler("z", 40, degrees=True).as_matrix(), np.array([3.0, 2, 1]))
    small = [transformed_depth_map(m, level_from_enu) for m in second]
    wrong = into_the_way()
    expected = share(second, wrong, first, HERE)
    assert share(small, wrong @ level_from_enu.inverse(), first, HERE) == pytest.approx(expected, abs=0.02)


def test_models_without_overlap_have_no_conflict(first: list[DepthMap], second: list[DepthMap]) -> None:
    far = Similarity(1.0, np.eye(3), np.array([500.0, 0.0, 0.0]))
    assert share(first, HERE, second, far) == 0


def test_a_hypothesis_that_contradicts_another_component_is_excluded(
    first: list[DepthMap], second: list[DepthMap]
) -> None:
    """Alone the second component is refused, since two hypotheses compete; one of them contradicts the first."""
    clear, ambiguous = hypotheses((80.0, HERE)), hypotheses((60.0, into_the_way()), (55.0, HERE))
    assert "another place is nearly as likely" in ambiguous.decide().reason
    found = decide_jointly(["a", "b"], [clear, ambiguous], [first, second])
    assert [r.registered for r in found] == [True, True]
    assert found[1].enu_from_level is HERE
    assert found[1].diagnostics["second_contrast"] == 0
    assert found[1].diagnostics["guesses"] == 3
    # The order in which they come does not matter.
    swapped = decide_jointly(["b", "a"], [ambiguous, clear], [second, first])
    assert swapped[0].enu_from_level is HERE


def test_a_component_without_another_hypothesis_is_refused_by_name(
    first: list[DepthMap], second: list[DepthMap]
) -> None:
    wrong = into_the_way()
    for lost in (hypotheses((60.0, wrong)), OneHypothesis(Registration(True, "", wrong, diagnostics={"score": 60.0}))):
        found = decide_jointly(["walk-0", "walk-1"], [hypotheses((80.0, HERE)), lost], [first, second])
        assert [r.registered for r in found] == [True, False]
        assert "contradicts walk-0" in found[1].reason


def test_the_more_confident_component_is_kept(first: list[DepthMap], second: list[DepthMap]) -> None:
    wrong = into_the_way()
    found = decide_jointly(["a", "b"], [hypotheses((50.0, HERE)), hypotheses((90.0, wrong))], [first, second])
    assert [r.registered for r in found] == [False, True]
    assert decide_jointly([], [], []) == []
    refused = OneHypothesis(Registration(False, "too few", None))
    assert decide_jointly(["a"], [refused], [first])[0].reason == "too few"
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in second]
    searches = [hypotheses((80.0, HERE)), hypotheses((60.0, wrong))]
    assert decide_jointly(["a", "b"], searches, [first, blind])[1].registered


def test_scores_come_in_the_order_of_the_hypotheses() -> None:
    found = hypotheses((60.0, HERE), (20.0, into_the_way()))
    assert found.scores == [candidate.odds for candidate in found.candidates]
    assert found.scores[0] > found.scores[1] and len(found.similarities) == 2
    assert OneHypothesis(Registration(True, "", HERE, n_inliers=70)).scores == [70.0]
    assert OneHypothesis(Registration(False, "too few", None)).scores == []
