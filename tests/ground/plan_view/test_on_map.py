# SPDX-License-Identifier: Apache-2.0
"""Without airborne photos: a walk is placed on a reference with its accuracy, and refused where it does not belong."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skymoor.geo import EnuFrame
from skymoor.geometry import point_covariance
from skymoor.ground.plan_view import OnMapHypotheses, OnMapOptions, map_target, search_on_map
from skymoor.ground.plan_view.on_map import chance_of_lead
from skymoor.ground.walls import transformed_depth_map
from skymoor.types import DepthMap, Reference, Registration
from support.houses import Houses, houses, site_with_an_l, walk_round_the_l
from support.plan_walks import EYE_M, GRID, camera_gaps, floated, walked_l

GROUND_UP_M = 31.0  # of the ground in the reference


def reference(world: Houses | None, *, relief: bool = True) -> Reference:
    """A grey orthophoto and the heights of a site; one height, or nothing but the orthophoto without `world`."""
    shape = GRID.shape
    up = np.full(shape, np.nan, np.float32)
    if world is not None:
        up = (world.tops(GRID.centres()) + GROUND_UP_M).astype(np.float32)
    rgb = np.full((*shape, 3), 100, np.uint8)
    pixel = GRID.pixel_m if relief else float("inf")
    return Reference(EnuFrame(48.0, 9.0, 300.0), GRID, rgb, np.ones(shape, bool), up, np.eye(3), pixel)


@lru_cache(maxsize=1)
def maps_level() -> list[DepthMap]:
    """The walk round the house of `site_with_an_l`, with the ground at 0 and eyes at 1."""
    level_from_enu = floated().inverse()
    return [transformed_depth_map(one, level_from_enu) for one in walk_round_the_l(site_with_an_l())]


def searched(world: Houses) -> OnMapHypotheses:
    """Narrower than by default, for time only."""
    options = OnMapOptions()
    return search_on_map(
        maps_level(), map_target(reference(world)), options, min_scale=1.4, max_scale=2.2, rng=np.random.default_rng(0)
    )


@pytest.fixture(scope="module")
def at_home() -> Registration:
    return searched(site_with_an_l()).decide()


def test_it_is_placed_where_it_was_with_an_accuracy_that_holds(at_home: Registration) -> None:
    assert at_home.registered, at_home.reason
    found, truth = at_home.enu_from_level, floated()
    assert found is not None and at_home.covariance is not None and at_home.centroid_enu is not None
    assert camera_gaps(walked_l(), found, truth).max() < 1.5
    centres = found.apply(walked_l().cameras)
    spread = np.sqrt(point_covariance(at_home.covariance, at_home.centroid_enu, centres)[:, [0, 1], [0, 1]])
    errors = (centres - truth.apply(walked_l().cameras))[:, :2]
    assert (np.abs(errors) < 4 * spread).all()
    assert (spread > 0.2).all() and (spread < 4.0).all()
    np.testing.assert_allclose(np.median(centres[:, 2]), GROUND_UP_M + EYE_M, atol=0.4)
    assert at_home.heights is not None and at_home.heights.status == "OFFSET_ONLY"


def test_elsewhere_it_is_refused_with_the_numbers(at_home: Registration) -> None:
    found = searched(houses(7)).decide()
    assert not found.registered
    assert "among wrong places alone that happens with probability" in found.reason
    assert f"{found.diagnostics['plan_score']:.1f}" in found.reason
    assert [one.kind for one in found.criteria] == ["map_places", "chance_of_lead"]
    assert at_home.diagnostics["plan_score"] > 1.3 * found.diagnostics["plan_score"]


def test_an_excluded_place_is_not_taken() -> None:
    hypotheses = searched(site_with_an_l())
    assert len(hypotheses.similarities) == len(hypotheses.scores) == 3
    second = hypotheses.decide(excluded=[0])
    assert not second.registered and second.enu_from_level is hypotheses.similarities[1]
    none = hypotheses.decide(excluded=[0, 1, 2])
    assert none.enu_from_level is None and "fit nowhere on the reference" in none.reason


@pytest.mark.parametrize(("world", "up_m"), [(None, 0.0), (houses(7), GROUND_UP_M)])
def test_without_relief_there_are_no_height_steps(world: Houses | None, up_m: float) -> None:
    flat = reference(world, relief=False)
    if world is not None:
        flat = replace(flat, height=np.full(GRID.shape, GROUND_UP_M, np.float32))
    target = map_target(flat)
    assert not target.plan.steps.any() and target.plan.known.all() and target.plan.colour is not None
    up = target.ground_at(np.array([[0.0, 0.0], [500.0, 0.0]]))
    assert np.isnan(up[1])
    assert np.isnan(up[0]) if world is None else up[0] == up_m


@pytest.mark.parametrize(("count", "scale"), [(24, 1.0), (200, 3.0)])
def test_the_chance_of_a_lead_is_that_of_wrong_places_whatever_their_number(count: int, scale: float) -> None:
    """Scores of wrong places with an exponential tail: a lead of probability p happens so often."""
    rng, chances = np.random.default_rng(0), []
    for _ in range(4000):
        best, *others = np.sort(rng.exponential(scale, count))[::-1][:24]
        chances.append(chance_of_lead(best, others))
    for p in (0.01, 0.05, 0.2):
        assert 0.7 * p < np.mean(np.array(chances) <= p) < 1.3 * p


def test_few_others_tell_nothing() -> None:
    assert chance_of_lead(50.0, [1.0, 2.0, 3.0]) == 1.0
    assert chance_of_lead(2.0, [3.0, *np.linspace(0, 1, 10)]) == 1.0
    assert chance_of_lead(50.0, list(np.linspace(0, 1, 10))) < 1e-6
