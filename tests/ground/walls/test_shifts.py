# SPDX-License-Identifier: Apache-2.0
"""Shifts of a pose are found by the pictures of its walls, also across a wall, and scored as the poses are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.ground.walls import Wall, facade_of, height_raster_of, pair_facades, surface_of
from skymoor.ground.walls.facade_search import agreement_of_channels
from skymoor.ground.walls.facades import set_back
from skymoor.ground.walls.shifts import PoseEvidence, ShiftOptions, WallPictures, agreement_of_shifts, best_shift
from skymoor.match.channels import ChannelOptions, make_channels
from skymoor.match.correlate import Target
from skymoor.types import Array
from support.houses import Houses, walk_round

BOX = Houses(np.array([[0.0, 0.0]]), np.array([[8.0, 6.0]]), np.array([7.0]), np.array([0.0]), seed=5)
SOUTH = Wall(np.array([0.0, -1.0]), 6.0, -8.0, 8.0, 0.0, 7.0, 100.0)
EAST = Wall(np.array([1.0, 0.0]), 8.0, -6.0, 6.0, 0.0, 7.0, 80.0)
WALK = walk_round(BOX, 0)
FACADES = [facade_of(wall, WALK, 0.2) for wall in (SOUTH, EAST)]
HEIGHTS = height_raster_of(surface_of(WALK))


def pictures_at(pose: Similarity) -> Callable[[float], WallPictures]:
    def pictures(outwards: float) -> WallPictures:
        walls = [set_back(facade, outwards) for facade in FACADES]
        pairs = pair_facades(walls, HEIGHTS, WALK, pose)
        options = ChannelOptions(smooth_px=1.3), ChannelOptions()
        channels = [map(make_channels, (one.ground, one.airborne), options) for one in pairs]
        return [(one.facade, ground, Target(other)) for one, (ground, other) in zip(pairs, channels, strict=True)]

    return pictures


def shifted(metres: Array) -> Similarity:
    return Similarity(1.0, np.eye(3), np.asarray(metres))


def nothing_in_plan(east_north: Array) -> Array:
    return np.full(len(east_north), np.nan)


@pytest.mark.parametrize("wrong", [(1.2, -0.6, 0.4), (-0.8, 2.0, -0.6), (2.2, -1.4, 0.0)])
def test_the_shift_of_a_pose_is_found_along_and_across_the_walls(wrong: tuple[float, float, float]) -> None:
    evidence = PoseEvidence(pictures_at(shifted(np.array(wrong))), nothing_in_plan, np.zeros_like)
    found = best_shift(evidence, ShiftOptions(distance_step_m=0.75))
    assert found == pytest.approx(-np.array(wrong), abs=0.3)


def test_what_pictures_do_not_tell_the_plan_tells() -> None:
    def in_plan(east_north: Array) -> Array:
        return np.asarray(20 - 10 * np.abs(east_north - [1.0, -2.0]).sum(axis=1))

    found = best_shift(PoseEvidence(lambda _: [], in_plan, lambda up: (up - 0.5) ** 2))
    assert found == pytest.approx([1.0, -2.0, 0.5])


def test_scores_are_those_of_the_shifted_poses() -> None:
    east_north, up = np.array([[0.0, 0.0], [0.4, 0.0], [0.0, -0.8], [-1.0, 0.6]]), np.array([-0.4, 0.0, 0.4])
    found = agreement_of_shifts(pictures_at(shifted(np.zeros(3))), east_north, up, np.array([-0.8, 0.0, 0.8]))
    for row, (east, north) in zip(found, east_north, strict=True):
        for value, height in zip(row, up, strict=True):
            pictures = pictures_at(shifted(np.array([east, north, height])))(0.0)
            _, expected = agreement_of_channels([(ground, target.channels) for _, ground, target in pictures])
            assert value == pytest.approx(expected, abs=9.0)
    at_rest = found[0, 1]
    assert found.argmax() == 1
    assert found[1:].max() < 0.9 * at_rest
    assert found[2:].max() < 0.25 * at_rest
