# SPDX-License-Identifier: Apache-2.0
"""A similarity scores high where the component was, and low inside houses and off the map."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.ground.plan_view import PlanScores, PlanSearchOptions, ScoreOptions, search_plan
from support.houses import site_with_an_l
from support.plan_walks import camera_gaps, floated, from_above, open_ground, walked_l


@pytest.fixture(scope="module")
def scores() -> PlanScores:
    return PlanScores(walked_l(), from_above(site_with_an_l()), ScoreOptions())


def moved(east_m: float, north_m: float, *, factor: float = 1.0, turn_deg: float = 0.0) -> Similarity:
    """The true similarity, turned and scaled about the model's centre, and moved."""
    truth = floated()
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    pivot = truth.apply(np.array([[*walked_l().centre, 0.0]]))[0]
    return Similarity(factor, turn, pivot + [east_m, north_m, 0.0] - factor * turn @ pivot) @ truth


def test_the_true_place_scores_like_the_best_of_the_search(scores: PlanScores) -> None:
    truth = floated()
    options = PlanSearchOptions(min_scale=truth.scale, max_scale=1.01 * truth.scale)
    best = search_plan(walked_l(), scores.target, options)[0]
    assert camera_gaps(walked_l(), best.enu_from_level, truth).max() < 1.5
    assert 0.9 * best.score < scores.at(truth) < 1.25 * best.score


@pytest.mark.parametrize(
    ("east_m", "north_m", "factor", "turn_deg"), [(4, 0, 1, 0), (0, -4, 1, 0), (0, 0, 1, 30), (0, 0, 1.3, 0)]
)
def test_other_places_azimuths_and_scales_score_lower(
    scores: PlanScores, east_m: float, north_m: float, factor: float, turn_deg: float
) -> None:
    assert scores.at(moved(east_m, north_m, factor=factor, turn_deg=turn_deg)) < 0.6 * scores.at(floated())


def test_an_error_of_a_cell_does_not_matter(scores: PlanScores) -> None:
    right = scores.at(floated())
    assert scores.at(moved(0.7, 0.0)) == pytest.approx(right, rel=0.1)


def test_all_shifts_score_as_they_do_one_by_one(scores: PlanScores) -> None:
    cell = scores.target.grid.pixel_m
    shifts = cell * np.array([[0.0, 0.0], [2.0, -1.0], [-3.0, 2.0], [0.0, 4.0]])
    expected = [scores.at(moved(east, north)) for east, north in shifts.tolist()]
    assert scores.shifted(floated(), shifts) == pytest.approx(expected, abs=0.05)
    assert np.isnan(scores.shifted(moved(1e4, 0.0), shifts)).all()


@pytest.mark.parametrize("house", [0, 2, 3, 4])
def test_inside_a_house_it_scores_lower_than_in_front(scores: PlanScores, house: int) -> None:
    cameras = floated().apply(walked_l().cameras)[:, :2]
    east_m, north_m = (float(x) for x in site_with_an_l().middle[house] - cameras[0])
    for step_m in (-0.5, 0.0, 0.5):
        assert scores.at(moved(east_m + step_m, north_m)) < 0.6 * scores.at(floated())


def test_free_space_within_houses_is_taken_off(scores: PlanScores) -> None:
    lenient = PlanScores(scores.model, scores.target, ScoreOptions(inside_weight=0.0))
    cameras = floated().apply(walked_l().cameras)[:, :2]
    east_m, north_m = (float(x) for x in site_with_an_l().middle[0] - cameras[0])
    inside = moved(east_m, north_m)
    assert lenient.at(inside) - scores.at(inside) > 1.5
    assert 0 <= lenient.at(floated()) - scores.at(floated()) < 0.7


def test_off_the_map_there_is_no_score(scores: PlanScores) -> None:
    assert np.isnan(scores.at(moved(300.0, 0.0)))
    assert np.isnan(scores.at(moved(0.0, -55.0)))
    assert np.isfinite(scores.at(moved(5.0, 5.0)))
    # So large that it does not fit on the map.
    assert np.isnan(scores.at(moved(0.0, 0.0, factor=6.0)))


def test_open_ground_scores_nothing() -> None:
    flat = PlanScores(walked_l(), open_ground(0.0), ScoreOptions())
    assert flat.at(floated()) == pytest.approx(0.0, abs=0.1)
