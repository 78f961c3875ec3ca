# SPDX-License-Identifier: Apache-2.0
"""Where things stand, and what the ground looks like there."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from skymoor.simulate.mesh import Label, inside
from skymoor.simulate.options import Preset, SiteOptions
from skymoor.simulate.place.ground import paint_ground
from skymoor.simulate.place.land import make_land, terrain, water
from skymoor.simulate.place.layout import Plan, make_plan

PRESETS: tuple[Preset, ...] = ("office-park", "industrial", "flooded")


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
