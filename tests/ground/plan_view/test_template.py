# SPDX-License-Identifier: Apache-2.0
"""The plan of a component: normals point out of its walls, free space is before its cameras, and both turn alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.errors import DegenerateGeometry
from skymoor.ground.plan_view import PlanModel, plan_model
from support.houses import site_with_an_l, walk_round_the_l
from support.plan_walks import floated, walked_l

SIDE = 60


def hand_made(side: int = SIDE) -> PlanModel:
    """A wall that faces west beside free space, off the middle."""
    normals, free = np.zeros((2, side, side), np.float32), np.zeros((side, side), np.float32)
    normals[0, 10:30, 40] = -1.0
    free[12:28, 20:40] = 1.0
    nothing = np.zeros((side, side, 3), np.uint8), np.zeros((side, side), bool)
    return PlanModel(normals, free, *nothing, 0.5, np.zeros(2), np.zeros((1, 3)))


@pytest.mark.parametrize("side", [SIDE, SIDE + 1])
def test_a_quarter_turn_turns_normals_and_free_space(side: int) -> None:
    model = hand_made(side)
    normals, free = model.at_scale(1.5, 0.75).turned(0.0)
    for quarter in (1, 2, 3):
        turned_normals, turned_free = model.at_scale(1.5, 0.75).turned(quarter * np.pi / 2)
        # np.rot90 turns counter-clockwise, as seen with rows going down.
        np.testing.assert_allclose(turned_free, np.rot90(free, quarter), atol=1e-3)
        u, v = (np.rot90(one, quarter) for one in normals)
        for _ in range(quarter):
            u, v = v, -u
        np.testing.assert_allclose(turned_normals, np.stack([u, v]), atol=1e-3)


def test_a_wall_that_faces_west_faces_south_after_a_quarter_turn() -> None:
    (u, v), _ = hand_made().at_scale(1.5, 0.75).turned(0.0)
    assert u.sum() < -5
    assert abs(v.sum()) < 1e-3
    (u, v), _ = hand_made().at_scale(1.5, 0.75).turned(np.pi / 2)
    assert abs(u.sum()) < 1e-3
    assert v.sum() > 5  # v runs down


def test_the_centre_stays_in_the_middle_and_areas_grow_with_the_scale() -> None:
    _, small = hand_made().at_scale(1.5, 0.75).turned(0.4)
    _, large = hand_made().at_scale(3.0, 0.75).turned(0.4)
    assert large.sum() / small.sum() == pytest.approx(4.0, rel=0.05)
    assert small.sum() == pytest.approx(hand_made().free.sum(), rel=0.05)  # pixels of 0.5 units are cells of 0.75 m
    rows, columns = np.nonzero(hand_made().free)
    arm = np.array([columns.mean() + 0.5, rows.mean() + 0.5]) - SIDE / 2
    rows, columns = np.nonzero(small > 0.5)
    turned_arm = np.array([columns.mean() + 0.5, rows.mean() + 0.5]) - small.shape[0] / 2
    c, s = np.cos(0.4), np.sin(0.4)
    np.testing.assert_allclose(turned_arm, [c * arm[0] + s * arm[1], -s * arm[0] + c * arm[1]], atol=0.3)


def test_a_walk_has_its_walls_and_free_space_where_they_are() -> None:
    model, truth, world = walked_l(), floated(), site_with_an_l()
    rows, columns = np.meshgrid(*(np.arange(model.free.shape[0]),) * 2, indexing="ij")
    level = model.centre + (np.stack([columns, rows], axis=-1) + 0.5 - model.free.shape[0] / 2) * [1, -1] * model.pixel
    enu = truth.apply(np.concatenate([level, np.zeros((*rows.shape, 1))], axis=-1).reshape(-1, 3))
    plan = enu[:, :2].reshape(*rows.shape, 2)
    assert (world.tops(plan)[model.free > 0.9] > 0).mean() < 0.1
    assert model.free.max() == 1.0
    # Half a metre outwards of a wall is the ground, half a metre inwards the house.
    weight = np.hypot(*model.normals)
    wall = weight > 0.5 * weight.max()
    level_normals = np.stack([model.normals[0], -model.normals[1]], axis=-1)[wall] / weight[wall, None]
    outwards = level_normals @ truth.rotation[:2, :2].T
    assert wall.sum() > 100
    assert (world.tops(plan[wall] + 0.5 * outwards) == 0).mean() > 0.95
    assert (world.tops(plan[wall] - 0.5 * outwards) > 0).mean() > 0.95
    assert truth.scale * model.pixel < 0.5


def test_photos_without_a_steep_surface_are_refused() -> None:
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in walk_round_the_l(site_with_an_l(), count=2)]
    with pytest.raises(DegenerateGeometry, match="no steep surface"):
        plan_model(blind, rng=np.random.default_rng(0))
