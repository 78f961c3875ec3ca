# SPDX-License-Identifier: Apache-2.0
"""A walk round a house is found on the height steps of its site, and on no other."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geo import Grid
from skymoor.ground.plan_view import PlanHypothesis, PlanSearchOptions, plan_target, search_plan
from support.houses import site_with_an_l
from support.plan_walks import EYE_M, GRID, camera_gaps, floated, from_above, open_ground, walked_l, without

# Narrower than by default, for time only.
QUICK = PlanSearchOptions(min_scale=1.4, max_scale=2.2)


@pytest.fixture(scope="module")
def found() -> list[PlanHypothesis]:
    return search_plan(walked_l(), from_above(site_with_an_l()), QUICK)


def test_the_best_hypothesis_is_the_true_place(found: list[PlanHypothesis]) -> None:
    best, truth = found[0], floated()
    assert camera_gaps(walked_l(), best.enu_from_level, truth).max() < 1.5
    assert best.enu_from_level.scale / EYE_M == pytest.approx(1.0, abs=0.1)
    turn = best.enu_from_level.rotation @ truth.rotation.T
    assert np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) == pytest.approx(0.0, abs=5.0)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)


def test_hypotheses_are_apart_and_the_best_come_first(found: list[PlanHypothesis]) -> None:
    scores = [one.score for one in found]
    assert 5 < len(found) <= QUICK.keep
    assert scores == sorted(scores, reverse=True)
    assert scores[1] < 0.95 * scores[0]
    for k, one in enumerate(found):
        for other in found[:k]:
            assert camera_gaps(walked_l(), one.enu_from_level, other.enu_from_level).mean() >= QUICK.apart_m


def test_a_place_at_the_north_western_border_of_the_map_is_found() -> None:
    rows, columns = GRID.shape
    north, west = round((GRID.north0 - 16.0) / GRID.pixel_m), round((-38.0 - GRID.east0) / GRID.pixel_m)
    grid = Grid(
        GRID.east0 + west * GRID.pixel_m,
        GRID.north0 - north * GRID.pixel_m,
        GRID.pixel_m,
        (rows - north, columns - west),
    )
    target = plan_target(site_with_an_l().tops(grid.centres()).astype(np.float32), grid)
    best = search_plan(walked_l(), target, PlanSearchOptions(min_scale=1.6, max_scale=1.9))[0]
    assert camera_gaps(walked_l(), best.enu_from_level, floated()).max() < 1.5


def test_fewer_are_kept_when_fewer_are_asked_for(found: list[PlanHypothesis]) -> None:
    narrow = PlanSearchOptions(min_scale=1.6, max_scale=1.9, keep=2, apart_m=8.0)
    kept = search_plan(walked_l(), from_above(site_with_an_l()), narrow)
    assert len(kept) == 2
    assert camera_gaps(walked_l(), kept[0].enu_from_level, kept[1].enu_from_level).mean() >= 8.0
    assert camera_gaps(walked_l(), kept[0].enu_from_level, floated()).max() < 1.5


@pytest.mark.parametrize("rough_m", [0.0, 0.2])
def test_open_ground_scores_far_lower(found: list[PlanHypothesis], rough_m: float) -> None:
    narrow = PlanSearchOptions(min_scale=1.6, max_scale=1.9)
    elsewhere = search_plan(walked_l(), open_ground(rough_m), narrow)
    assert all(one.score < 0.55 * found[0].score for one in elsewhere)


def test_a_site_without_the_house_scores_lower(found: list[PlanHypothesis]) -> None:
    others = search_plan(walked_l(), from_above(without(site_with_an_l(), [0, 1])), QUICK)
    assert others[0].score < 0.8 * found[0].score


def test_a_map_smaller_than_the_component_has_no_place_for_it() -> None:
    up = np.zeros((12, 12), np.float32)
    assert search_plan(walked_l(), plan_target(up, Grid(0.0, 9.0, 0.75, up.shape)), QUICK) == []


def test_no_scale_outside_of_the_limits_is_returned() -> None:
    larger = search_plan(walked_l(), from_above(site_with_an_l()), PlanSearchOptions(min_scale=2.4, max_scale=2.6))
    assert larger
    assert all(2.4 <= one.enu_from_level.scale <= 2.6 for one in larger)


def test_progress_counts_the_scales() -> None:
    calls = []

    def progress(done: int, total: int, _: str = "") -> None:
        calls.append((done, total))

    options = PlanSearchOptions(min_scale=1.6, max_scale=1.9, azimuth_ratio=0.95)
    search_plan(walked_l(), open_ground(0.0), options, progress=progress)
    assert calls == [(k + 1, len(calls)) for k in range(len(calls))]
    assert len(calls) == 3
