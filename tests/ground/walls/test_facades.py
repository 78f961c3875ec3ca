# SPDX-License-Identifier: Apache-2.0
"""Facades: what is seen on them, what hides them, and how two of them relate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.ground.walls import (
    Facade,
    FacadeOptions,
    Wall,
    affine_between,
    check_visibility,
    facade_of,
    find_walls,
    height_raster_of,
    pair_facades,
    similarity_between,
    surface_of,
    view_rays_of,
)
from skymoor.types import DepthMap, Raster
from support.houses import Houses, walk_round

BOX = Houses(np.array([[0.0, 0.0]]), np.array([[8.0, 6.0]]), np.array([7.0]), np.array([0.0]), seed=5)
SOUTH = Wall(np.array([0.0, -1.0]), 6.0, -8.0, 8.0, 0.0, 7.0, 100.0)


@pytest.fixture(scope="module")
def walk() -> list[DepthMap]:
    return walk_round(BOX, 0)


def test_a_facade_shows_the_wall_s_texture(walk: list[DepthMap]) -> None:
    facade = facade_of(SOUTH, walk, 0.1, FacadeOptions(margin_m=0.0))
    texture = BOX._wall(0)[:70, :160][::-1]
    assert facade.raster.mask.shape == (70, 160)
    seen = facade.raster.mask
    assert seen[5:65, 80:].mean() > 0.8
    shown = facade.raster.rgb[..., 0].astype(float)
    assert np.corrcoef(shown[seen], texture[seen])[0, 1] > 0.8
    mirrored = texture[:, ::-1]
    assert np.corrcoef(shown[seen], mirrored[seen])[0, 1] < 0.5


def test_what_stands_before_a_wall_hides_it(walk: list[DepthMap]) -> None:
    near = [replace(m, depth=np.full_like(m.depth, 3.0)) for m in walk]
    assert not facade_of(SOUTH, near, 0.1).raster.mask.any()


def test_windows_without_depth_are_shown_within_the_wall_only(walk: list[DepthMap]) -> None:
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in walk]
    narrow = facade_of(SOUTH, blind, 0.1).raster.mask
    wide = facade_of(SOUTH, blind, 0.1, FacadeOptions(no_depth_margin_m=1.0)).raster.mask
    assert narrow[12:78, 100:168].any()
    assert not narrow[:, 171:].any()
    assert wide[:, 171:].any()


def test_no_photo_from_behind_shows_a_wall(walk: list[DepthMap]) -> None:
    north = replace(SOUTH, normal=np.array([0.0, 1.0]))
    assert not facade_of(north, walk, 0.1).raster.mask.any()


def blank(wall: Wall, pixel_m: float) -> Facade:
    h, w = round((wall.z1 - wall.z0) / pixel_m), round((wall.s1 - wall.s0) / pixel_m)
    return Facade(wall, Raster(np.zeros((h, w, 3), np.uint8), np.ones((h, w), dtype=bool)), pixel_m, wall.s0, wall.z1)


def test_affine_and_similarity_undo_each_other() -> None:
    a = blank(SOUTH, 0.1)
    b = blank(Wall(np.array([0.8, 0.6]), 11.0, 3.0, 30.0, 1.0, 12.0, 200.0), 0.25)
    b_from_a = np.array([[0.7, 0.0, 12.0], [0.0, 0.7, -4.0]])
    similarity = similarity_between(a, b, b_from_a)
    assert similarity.scale == pytest.approx(0.7 * 0.25 / 0.1)
    assert affine_between(a, b, similarity) == pytest.approx(b_from_a, abs=1e-9)
    corner = np.array([[3.0, 5.0]])
    placed = b.xyz(corner @ b_from_a[:, :2].T + b_from_a[:, 2])
    assert similarity.apply(a.xyz(corner)) == pytest.approx(placed, abs=1e-9)


def test_cameras_stand_on_the_ground_and_do_not_look_through_walls(walk: list[DepthMap]) -> None:
    surface = surface_of(walk)
    relief, walls = height_raster_of(surface), find_walls(surface, rng=np.random.default_rng(0))
    sight = view_rays_of(walk, rng=np.random.default_rng(0))
    right = check_visibility(sight, Similarity.identity(), relief, walls)
    assert right.height_m == pytest.approx(1.6, abs=0.1)
    assert right.blocked < 0.02
    # A tree over all of it hides the people below, and is no wall.
    tree = replace(relief, height=np.full_like(relief.height, 7.0))
    assert check_visibility(sight, Similarity.identity(), tree, walls).blocked < 0.02
    across = replace(SOUTH, offset=10.0, s0=-60.0, s1=60.0)
    assert check_visibility(sight, Similarity.identity(), relief, [across]).blocked > 0.3
    low = replace(across, z1=across.z0 + 0.5)
    assert check_visibility(sight, Similarity.identity(), relief, [low]).blocked < 0.02
    away = Similarity(1.0, np.eye(3), np.array([1000.0, 0.0, 0.0]))
    assert check_visibility(sight, away, relief, walls).outside == 1.0


def test_counterparts_lie_on_the_facade_s_own_grid(walk: list[DepthMap]) -> None:
    facade = facade_of(SOUTH, walk, 0.2)
    relief = height_raster_of(surface_of(walk))
    (pair,) = pair_facades([facade], relief, walk, Similarity.identity())
    assert pair.ground.mask.shape == pair.airborne.mask.shape
    both = pair.ground.mask & pair.airborne.mask
    near, far = pair.ground.rgb[both][:, 0].astype(float), pair.airborne.rgb[both][:, 0].astype(float)
    assert both.sum() > 1000
    assert np.corrcoef(near, far)[0, 1] > 0.9
    behind = Similarity(1.0, np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    assert not pair_facades([facade], relief, walk, behind)
