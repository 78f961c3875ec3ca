# SPDX-License-Identifier: Apache-2.0
"""Where things stand, and what the ground looks like there."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from typing import get_args

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.simulate.mesh import Label, inside
from skymoor.simulate.options import Preset, SiteOptions
from skymoor.simulate.place.ground import paint_ground
from skymoor.simulate.place.land import make_land, terrain, water
from skymoor.simulate.place.layout import Plan, make_plan

PRESETS: tuple[Preset, ...] = get_args(Preset)


@cache
def plan_of(preset: Preset, seed: int = 3) -> Plan:
    return make_plan(SiteOptions(preset=preset, seed=seed, radius_m=60.0))


@pytest.mark.parametrize("preset", PRESETS)
def test_buildings_stand_apart_within_the_site(preset: Preset) -> None:
    plan = plan_of(preset)
    assert len(plan.buildings) >= 3
    outlines = [building.outline_enu for building in plan.buildings]
    for one, other in itertools.permutations(outlines, 2):
        assert not inside(one, other).any()
    assert max(np.abs(outline).max() for outline in outlines) < 60 + 35
    assert min(np.abs(d.outline_enu).max() for d in plan.distractors) > 60


@pytest.mark.parametrize("preset", PRESETS)
def test_no_tree_grows_in_a_house_or_in_water(preset: Preset) -> None:
    plan = plan_of(preset)
    assert len(plan.trees) > 30
    for building in (*plan.buildings, *plan.distractors):
        assert not inside(building.outline_enu, plan.trees[:, :2]).any()
    assert not any(plan.land.wet(east, north) for east, north in plan.trees[:, :2])


def test_groups_walk_round_buildings_that_are_far_apart() -> None:
    plan = make_plan(SiteOptions(seed=5))
    one, other = (b for b in plan.buildings if b.name in plan.walked)
    assert np.hypot(one.east - other.east, one.north - other.north) > 40


def test_equal_options_make_equal_plans_and_other_seeds_others() -> None:
    again = make_plan(SiteOptions(preset="industrial", seed=3, radius_m=60.0))
    assert again.buildings == plan_of("industrial").buildings
    np.testing.assert_array_equal(again.trees, plan_of("industrial").trees)
    assert plan_of("industrial", 4).buildings != again.buildings


def test_a_wider_reference_adds_neighbours_and_moves_nothing() -> None:
    narrow = SiteOptions(seed=3, radius_m=60.0, reference_width_m=200.0)
    near, wide = make_plan(narrow), make_plan(replace(narrow, reference_width_m=1000.0))
    assert len(wide.distractors) > 4 * len(near.distractors)
    assert wide.buildings == near.buildings


def test_twins_have_one_shape_and_one_look() -> None:
    plan = make_plan(SiteOptions(seed=3, radius_m=60.0, look_alikes="twins"))
    shapes = [(b.outline, b.looks, b.storeys) for b in plan.buildings]
    assert len(shapes) - len(set(shapes)) == 1
    assert all(building.repeated for building in plan.buildings)
    # Both are photographed: that is what they are for.
    assert len({b.looks for b in plan.buildings if b.name in plan.walked}) == 1


@pytest.mark.parametrize(("radius_m", "relief_m"), [(45.0, (14.0, 18.0)), (85.0, (27.0, 33.0)), (200.0, (27.0, 33.0))])
def test_hillsides_are_hilly_and_not_too_steep(radius_m: float, relief_m: tuple[float, float]) -> None:
    reach = min(radius_m, 85.0)
    side = np.linspace(-reach, reach, 91)
    east, north = np.meshgrid(side, side)
    within = np.hypot(east, north) <= reach
    for seed in range(6):
        up = make_land("hillside", seed, radius_m).height(east, north)
        slope = np.hypot(*np.gradient(up, side, side))[within]
        assert relief_m[0] < np.ptp(up[within]) < relief_m[1]
        assert 0.16 < slope.max() < 0.26 and slope.mean() > 0.1


def test_houses_on_a_hillside_stand_on_terraces() -> None:
    plan = plan_of("hillside")
    natural = replace(plan.land, terraces=())
    drops = []
    for building in (*plan.buildings, *plan.distractors):
        e, n = building.outline_enu.T
        np.testing.assert_allclose(plan.land.height(e, n), building.up - 0.1, atol=1e-9)
        drops.append(np.ptp(natural.height(e, n)))
    assert max(drops) > 2.0
    # Away from the houses the ground is as it was.
    e, n = np.random.default_rng(1).uniform(-250, 250, (2, 3000))
    same = np.abs(plan.land.height(e, n) - natural.height(e, n)) < 1e-9
    assert 0.7 < same.mean() < 1.0
    assert float(plan.land.height(0.0, 0.0)) == pytest.approx(plan.land.height(np.zeros((1, 1)), 0.0)[0, 0])


def canopy(plan: Plan) -> NDArray[np.bool_]:
    """Where crowns are, as discs, in cells of 1 m within the radius."""
    side = np.arange(-60.0, 60.0)
    east, north = np.meshgrid(side, side)
    covered = np.zeros(east.shape, bool)
    for e, n, _, crown in plan.trees:
        covered |= np.hypot(east - e, north - n) < crown
    return covered


def test_old_houses_stand_under_old_trees() -> None:
    for seed in range(3):
        plan = plan_of("old-houses", seed)
        assert 0.3 < canopy(plan).mean() < 0.6
        assert (plan.trees[:, 2] >= 12).all() and (plan.trees[:, 2] <= 20).all()
        assert (plan.trees[:, 3] > 4).all() and (plan.trees[:, 3] <= 7).all()
        outlines = [building.outline_enu.astype(np.float32) for building in plan.buildings]
        over = [
            any(
                cv2.pointPolygonTest(outline, (float(e), float(n)), True) > 0.5 - crown for e, n, _, crown in plan.trees
            )
            for outline in outlines
        ]
        assert np.mean(over) > 0.3
        assert all(b.roof in ("gable", "hip") and b.cover == "tiles" and b.storeys <= 2 for b in plan.buildings)
    assert canopy(plan_of("office-park")).mean() < 0.15


def test_the_pond_ends_where_the_land_rises() -> None:
    land = make_land("flooded", 2, 80.0)
    assert land.pond is not None and land.water_up is not None
    assert land.wet(0.0, 0.0) and not land.wet(70.0, 0.0)
    assert float(land.height(0.0, 0.0)) == pytest.approx(land.water_up - land.pond.depth_m, abs=1e-9)
    surface = water(land)
    assert (surface.label == Label.WATER).all()
    edge = surface.corners[np.abs(surface.corners[..., :2]).max(axis=-1) > 55]
    assert (land.height(edge[:, 0], edge[:, 1]) > edge[:, 2]).all()
    assert make_land("industrial", 2, 80.0).water_up is None


def test_flooded_buildings_know_their_water() -> None:
    plan = plan_of("flooded")
    wet = [b for b in plan.buildings if b.water_up is not None]
    assert wet and all(b.water_up is not None and b.up < b.water_up for b in wet)


def test_the_terrain_mesh_follows_the_land_without_gaps() -> None:
    land = make_land("office-park", 1, 40.0)
    part = terrain(land, 40.0, 100.0, 1, 2)
    plan = part.corners.reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(plan[:, 2], land.height(plan[:, 0], plan[:, 1]), atol=2e-3)
    edges = part.corners[:, 1:] - part.corners[:, :1]
    area = 0.5 * np.abs(np.linalg.det(edges[..., :2].astype(np.float64)))
    side = 2 * np.abs(plan[:, :2]).max()
    assert area.sum() == pytest.approx(side**2, rel=1e-4)


def test_places_look_alike_at_two_resolutions_and_in_two_seasons() -> None:
    plan = plan_of("office-park")
    fine = paint_ground(plan, 3, "summer", 40.0, 0.1)
    coarse = paint_ground(plan, 3, "summer", 80.0, 0.4)[100:300, 100:300]
    small = cv2.resize(fine, (200, 200), interpolation=cv2.INTER_AREA)
    assert np.corrcoef(small.ravel(), coarse.ravel())[0, 1] > 0.9
    winter = paint_ground(plan, 3, "winter", 40.0, 0.1)
    assert np.corrcoef(fine.mean(axis=2).ravel(), winter.mean(axis=2).ravel())[0, 1] > 0.5
    greenness = [float((image[..., 1] / image[..., 0]).mean()) for image in (fine, winter)]
    assert greenness[0] > 1.1 * greenness[1]


def test_roads_are_where_the_plan_says() -> None:
    plan = plan_of("office-park")
    picture = paint_ground(plan, 3, "summer", 60.0, 0.25)
    line = np.concatenate([np.array(s.line) for s in plan.strips])
    # Beside the dashes, and away from yards and crossings as far as a median sees.
    px = np.floor((line[np.abs(line).max(axis=1) < 55] * [1, -1] + 60) / 0.25).astype(int) + [3, 3]
    road = picture[px[:, 1], px[:, 0]]
    assert len(road) > 5
    assert np.median(road) == pytest.approx(0.15, abs=0.05)
    assert np.median(np.ptp(road, axis=1)) < 0.02
