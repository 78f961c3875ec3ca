# SPDX-License-Identifier: Apache-2.0
"""Walls of known boxes are found where they stand, whatever noise is put on their points."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.ground.walls import Surface, Wall, WallOptions, find_walls, surface_of, transformed_wall
from support.houses import Houses, from_the_air


def sheet(rng: np.random.Generator, *, heading_deg: float, noise_m: float, n: int = 20000) -> Surface:
    """Points of a wall 12 m long and 6 m high, at 5 m from the origin, that faces `heading_deg` from x."""
    angle = np.radians(heading_deg)
    normal, right = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    s, z = rng.uniform(-6, 6, n), rng.uniform(0, 6, n)
    plan = normal * (5 + rng.normal(scale=noise_m, size=n))[:, None] + s[:, None] * right
    normals = np.tile([*normal, 0.0], (n, 1))
    return Surface(np.column_stack([plan, z]).astype(np.float32), normals.astype(np.float32))


@pytest.mark.parametrize("noise_m", [0.0, 0.1])
def test_a_noisy_sheet_is_one_wall_of_its_size(rng: np.random.Generator, noise_m: float) -> None:
    (wall,) = find_walls(sheet(rng, heading_deg=37, noise_m=noise_m), rng=rng)
    assert np.degrees(np.arctan2(wall.normal[1], wall.normal[0])) == pytest.approx(37, abs=0.5)
    assert wall.offset == pytest.approx(5, abs=0.05)
    assert (wall.s0, wall.s1) == pytest.approx((-6, 6), abs=0.4)
    assert (wall.z0, wall.z1) == pytest.approx((0, 6), abs=0.4)


def test_a_gap_makes_two_walls(rng: np.random.Generator) -> None:
    whole = sheet(rng, heading_deg=0, noise_m=0.05)
    parted = whole.take(np.abs(whole.xyz[:, 1]) > 2)
    assert len(find_walls(parted, rng=rng)) == 2
    assert len(find_walls(parted, WallOptions(gap_m=5.0), rng=rng)) == 1


def test_ground_and_low_things_are_no_walls(rng: np.random.Generator) -> None:
    wall = sheet(rng, heading_deg=0, noise_m=0.05)
    assert not find_walls(wall.take(wall.xyz[:, 2] < 1), rng=rng)
    flat = Surface(wall.xyz[:, [0, 2, 1]], np.tile([0, 0, 1], (len(wall), 1)).astype(np.float32))
    assert not find_walls(flat, rng=rng)
    assert not find_walls(wall.take(np.zeros(len(wall), dtype=bool)), rng=rng)


def test_a_box_seen_from_the_air_has_four_walls_that_face_outwards(rng: np.random.Generator) -> None:
    world = Houses(np.array([[4.0, -3.0]]), np.array([[9.0, 6.0]]), np.array([8.0]), np.array([20.0]), seed=3)
    walls = find_walls(surface_of(from_the_air(world)), rng=rng)
    assert len(walls) == 4
    headings = sorted(np.degrees([np.arctan2(wall.normal[1], wall.normal[0]) for wall in walls]) % 90)
    assert headings == pytest.approx([20.0] * 4, abs=1.0)
    distances = sorted(wall.offset - wall.normal @ [4.0, -3.0] for wall in walls)
    assert distances == pytest.approx([6, 6, 9, 9], abs=0.15)


def test_a_moved_wall_holds_the_moved_points() -> None:
    wall = Wall(np.array([0.6, 0.8]), 3.0, -2.0, 4.0, 0.5, 5.0, 20.0)
    c, s = np.cos(1.1), np.sin(1.1)
    similarity = Similarity(2.0, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([5.0, -1.0, 2.0]))
    moved = transformed_wall(wall, similarity)
    assert moved.corners == pytest.approx(similarity.apply(wall.corners), abs=1e-9)
    assert moved.area_m2 == pytest.approx(80.0)
