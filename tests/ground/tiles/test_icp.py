# SPDX-License-Identifier: Apache-2.0
"""Clouds that are a bit apart come together, and ICP keeps its hands off where it can only harm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.errors import TooFewMatches
from skymoor.geometry import Similarity
from skymoor.ground.tiles.icp import IcpOptions, refine_icp
from support.comparators import assert_similarity_near

Array = NDArray[np.float64]

SMALL = IcpOptions()


def house(rng: np.random.Generator, count: int = 40000, noise_m: float = 0.02) -> Array:
    """Points on two walls, a wing and the ground."""
    u, v = rng.uniform(size=(2, count))
    part = rng.integers(0, 5, count)[:, None]
    o = np.zeros(count)
    faces = [
        np.column_stack([20 * u, o, 8 * v]),
        np.column_stack([o, 14 * u, 8 * v]),
        np.column_stack([20 + 6 * u, o + 5, 5 * v]),
        np.column_stack([o + 20, 5 * u, 8 * v]),
        np.column_stack([40 * u - 10, 30 * v - 15, o]),
    ]
    xyz = np.select([part == k for k in range(5)], faces)
    return xyz + rng.normal(scale=noise_m, size=xyz.shape)


def off(shift_m: float, *, turn_deg: float = 1.0, scale: float = 1.0) -> Similarity:
    rotation = Rotation.from_rotvec([0.2 * turn_deg, -0.1 * turn_deg, turn_deg], degrees=True).as_matrix()
    middle = np.array([10.0, 5.0, 3.0])
    return Similarity(scale, rotation, middle - scale * rotation @ middle + shift_m * np.array([0.6, -0.64, 0.48]))


@pytest.fixture(scope="module")
def clouds() -> tuple[Array, Array, Similarity]:
    """A ground model in its own frame, the airborne one, and where the first belongs."""
    rng = np.random.default_rng(1)
    air, ground = house(rng), house(rng)
    level_from_enu = Similarity(0.6, Rotation.from_euler("z", 130, degrees=True).as_matrix(), np.array([3.0, 4.0, 5.0]))
    return level_from_enu.apply(ground), air, level_from_enu.inverse()


def test_a_shift_and_a_turn_are_undone(clouds: tuple[Array, Array, Similarity]) -> None:
    ground, air, truth = clouds
    start = off(0.4) @ truth
    found = refine_icp(ground, air, start, SMALL)
    assert found.helped, found.reason
    error = found.target_from_source @ truth.inverse()
    assert_similarity_near(error, Similarity.identity(), rot_deg=0.05, trans_m=0.03, scale_ppm=1)
    assert 0.3 < found.moved_m < 0.6
    # The noise of both clouds is what is left.
    assert 0.01 < found.gap_after_m < 0.08 < found.gap_before_m
    assert 0.9 < found.overlap <= 1


def test_the_scale_is_undone_only_when_it_is_free(clouds: tuple[Array, Array, Similarity]) -> None:
    ground, air, truth = clouds
    start = off(0.2, turn_deg=0.3, scale=1.02) @ truth
    free = refine_icp(ground, air, start, replace(SMALL, with_scale=True))
    fixed = refine_icp(ground, air, start, SMALL)
    assert free.helped, free.reason
    assert abs(free.target_from_source.scale / truth.scale - 1) < 0.002
    assert fixed.target_from_source.scale == pytest.approx(start.scale)
    assert free.gap_after_m < 0.8 * fixed.gap_after_m


def test_what_only_one_cloud_has_does_not_pull(
    clouds: tuple[Array, Array, Similarity], rng: np.random.Generator
) -> None:
    ground, air, truth = clouds
    # A hedge half a metre before a wall, and people anywhere.
    hedge = np.column_stack([rng.uniform(0, 20, 6000), np.full(6000, -0.5), rng.uniform(0, 2, 6000)])
    people = rng.uniform([-10, -15, 0], [30, 15, 2], (3000, 3))
    more = np.vstack([ground, truth.inverse().apply(np.vstack([hedge, people]))])
    found = refine_icp(more, air, off(0.4) @ truth, SMALL)
    assert found.helped, found.reason
    error = found.target_from_source @ truth.inverse()
    assert np.linalg.norm(error.apply([10.0, 5.0, 3.0]) - [10.0, 5.0, 3.0]) < 0.05


def test_it_does_not_go_far(clouds: tuple[Array, Array, Similarity]) -> None:
    ground, air, truth = clouds
    start = off(0.6) @ truth
    found = refine_icp(ground, air, start, replace(SMALL, max_move_m=0.2))
    assert not found.helped
    assert "would move" in found.reason
    assert found.target_from_source is start
    assert found.moved_m > 0.2


def test_a_good_start_is_left_alone(clouds: tuple[Array, Array, Similarity]) -> None:
    ground, air, truth = clouds
    found = refine_icp(ground, air, truth, SMALL)
    assert not found.helped
    assert "closer" in found.reason
    assert found.target_from_source is truth


def test_a_wall_alone_leaves_a_direction_open(rng: np.random.Generator) -> None:
    plan = rng.uniform(size=(8000, 2)) * [20, 8]
    wall = np.column_stack([plan[:, 0], rng.normal(scale=0.01, size=8000), plan[:, 1]])
    found = refine_icp(wall + [0.0, 0.3, 0.0], wall, Similarity.identity(), SMALL)
    assert not found.helped
    assert "do not determine" in found.reason


def test_clouds_that_do_not_meet(clouds: tuple[Array, Array, Similarity]) -> None:
    ground, air, truth = clouds
    far = Similarity(1.0, np.eye(3), np.array([500.0, 0.0, 0.0])) @ truth
    found = refine_icp(ground, air, far, SMALL)
    assert not found.helped
    assert "partner" in found.reason
    with pytest.raises(TooFewMatches, match="source has 9 points"):
        refine_icp(ground[:9], air, truth, SMALL)
