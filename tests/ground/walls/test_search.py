# SPDX-License-Identifier: Apache-2.0
"""Which hypotheses are refined and matched: the best of each kind, and one of each place."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.walls import GroundOptions, RefinedHypothesis, WallHypothesis
from skymoor.ground.walls.search import _best_of_places, _finalists
from skymoor.types import Registration
from support.houses import houses, walk_round


def at(east_m: float, *, score: float = 30.0, plan_score: float = 5.0) -> RefinedHypothesis:
    """A hypothesis; without contrast, as the search finds it."""
    place = Similarity(1.0, np.eye(3), np.array([east_m, 0.0, 0.0]))
    nothing = Registration(False, "", None)
    seen = (score, 0.5, 2, 1.6, 0.0, 0, (), plan_score)
    return RefinedHypothesis(WallHypothesis(place, 0, 0, 30.0), nothing, place, *seen)


def test_finalists_are_those_that_fit_best_and_the_best_in_plan() -> None:
    on_walls = [at(10.0 * k, score=60.0 - k, plan_score=1.0) for k in range(5)]
    in_plan = [at(500 + 10.0 * k, score=9.0, plan_score=8.0 - k / 10) for k in range(5)]
    unknown = replace(in_plan[0], plan_score=float("nan"))
    found = _finalists([*in_plan, *on_walls, unknown], 6)
    assert len(found) == len({id(one) for one in found}) == 6
    assert sum(any(one is other for other in on_walls) for one in found) == 3
    assert sum(any(one is other for other in in_plan) for one in found) == 3
    assert _finalists(on_walls[:2], 6) == on_walls[:2]


def test_what_only_key_points_favour_is_refined_too() -> None:
    others = [replace(at(10.0 * k, score=60.0 - k), key_point_cells=3) for k in range(8)]
    told_by_key_points = replace(at(500.0, score=9.0, plan_score=1.0), key_point_cells=25)
    assert any(one is told_by_key_points for one in _finalists([*others, told_by_key_points], 4))
    without = replace(told_by_key_points, key_point_cells=None)
    assert not any(one is without for one in _finalists([*others, without], 4))


def test_of_each_place_the_best_fit_is_matched() -> None:
    maps = walk_round(houses(1), 0, count=3)
    search = SimpleNamespace(maps=maps, options=GroundOptions())
    # A metre aside the photos agree better; elsewhere are two more places.
    first, beside, far, further = at(0.0), at(1.0, score=50.0), at(40.0, score=20.0), at(80.0, score=15.0)
    found = _best_of_places([first, beside, far, further], 2, search)  # type: ignore[arg-type]
    assert [one is wanted for one, wanted in zip(found, (beside, far), strict=True)] == [True, True]
