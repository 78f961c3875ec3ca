# SPDX-License-Identifier: Apache-2.0
"""Steps in plan point away from houses, and what is interpolated is no house."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geo import Grid
from skymoor.ground.plan_view import plan_target
from skymoor.ground.walls import Wall

GRID = Grid(-20.25, 20.25, 0.5, (81, 81))
HOUSE = np.zeros(GRID.shape, np.float32)
HOUSE[30:51, 30:51] = 6.0
EAST, WEST, NORTH, SOUTH = np.s_[40, 41:], np.s_[40, :40], np.s_[:40, 40], np.s_[41:, 40]


def test_steps_point_away_from_a_house() -> None:
    u, v = plan_target(HOUSE, GRID).steps
    assert u[EAST].max() > 0.1
    assert u[EAST].min() > -1e-3
    assert u[WEST].min() < -0.1
    assert u[WEST].max() < 1e-3
    # v runs down.
    assert v[NORTH].min() < -0.1
    assert v[NORTH].max() < 1e-3
    assert v[SOUTH].max() > 0.1
    assert v[SOUTH].min() > -1e-3
    # The wall is between the pixels 50 and 51.
    assert np.average(np.arange(41, 81), weights=u[EAST]) == pytest.approx(50.5, abs=0.5)


def test_the_border_of_the_map_and_a_slope_are_no_steps() -> None:
    slope = (0.05 * GRID.centres()[..., 0]).astype(np.float32)
    target = plan_target(slope, GRID)
    assert np.abs(target.steps).max() < 0.03
    assert target.raised.max() == 0
    holed = np.where(np.arange(81) < 10, np.nan, np.zeros(GRID.shape)).astype(np.float32)
    assert np.abs(plan_target(holed, GRID).steps).max() < 1e-6
    assert plan_target(holed, GRID).known.sum() == 81 * 71


def test_what_is_interpolated_is_no_house() -> None:
    measured = plan_target(HOUSE, GRID)
    interpolated = plan_target(HOUSE, GRID, seen=HOUSE < 1.0)
    assert measured.raised[HOUSE > 1.0].mean() > 0.9
    assert interpolated.raised.max() == 0
    assert interpolated.known.all()


def test_a_roof_edge_is_a_step_where_the_heights_show_none() -> None:
    flat = np.zeros(GRID.shape, np.float32)
    wall = Wall(np.array([0.0, -1.0]), 6.0, -8.0, 8.0, 0.0, 7.0, 100.0)
    u, v = plan_target(flat, GRID, walls=[wall]).steps
    assert np.abs(u).max() < 1e-6
    # 6 m south of the middle, 26.25 m from the northern border.
    assert int(v[:, 40].argmax()) == 52
    assert v[52, 40] > 0.1
    assert np.abs(v[:40]).max() == 0
    assert np.abs(v[:, :20]).max() < 1e-3
    assert v.min() >= 0
