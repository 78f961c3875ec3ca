# SPDX-License-Identifier: Apache-2.0
"""Ground photos on airborne walls: a known similarity comes back, and another site is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.plan_view import PlanSearchOptions
from skymoor.ground.walls import (
    AcceptanceOptions,
    AirborneWalls,
    GroundOptions,
    PoolOptions,
    airborne_walls,
    check_poses_on_walls,
    search_ground,
    transformed_depth_map,
)
from skymoor.types import Array, Camera, DepthMap, Raster
from support.houses import centres, from_the_air, houses, walk_round

SITE, HOUSE = 1, 0
# Narrower than by default, for time only. So small a walk round one house shows too little for a chance of 1 %.
QUICK = GroundOptions(
    min_scale=1.5,
    max_scale=2.1,
    finalists=8,
    matched=1,
    plan=PlanSearchOptions(keep=8),
    pool=PoolOptions(keep=5),
    acceptance=AcceptanceOptions(max_chance=0.03),
)


@pytest.fixture(scope="module")
def walls() -> AirborneWalls:
    return airborne_walls(from_the_air(houses(SITE)), rng=np.random.default_rng(0))


def floated(maps: list[DepthMap], *, tilt_deg: float = 0.6) -> tuple[list[DepthMap], Similarity]:
    """Maps in a frame of their own, level but for a tilt, a unit near the cameras' height; and the way back."""
    rotation = Rotation.from_euler("z", 130, degrees=True) * Rotation.from_euler("x", tilt_deg, degrees=True)
    level_from_enu = Similarity(1 / 1.75, rotation.as_matrix(), np.array([40.0, -7.0, 3.0]))
    return [transformed_depth_map(depth_map, level_from_enu) for depth_map in maps], level_from_enu.inverse()


def alike(a: Raster, b: Raster) -> tuple[Array, Array]:
    """In place of a learned matcher: a point every two metres or so where the pictures are alike as a whole."""
    grey_a, grey_b = (x.rgb.mean(axis=2)[a.mask & b.mask] for x in (a, b))
    if len(grey_a) < 2 or np.corrcoef(grey_a, grey_b)[0, 1] < 0.6:
        return np.zeros((0, 2)), np.zeros((0, 2))
    rows, columns = np.nonzero((a.mask & b.mask)[::40, ::40])
    px = 40.0 * np.column_stack([columns, rows])
    return px, px


def test_a_walk_is_laid_where_it_was(walls: AirborneWalls) -> None:
    maps, enu_from_level = floated(walk_round(houses(SITE), HOUSE))
    with_key_points = replace(QUICK, key_points=alike)
    found = search_ground(maps, walls, with_key_points, rng=np.random.default_rng(0)).decide()
    assert found.registered, found.reason
    assert found.enu_from_level is not None
    gaps = found.enu_from_level.apply(centres(maps)) - enu_from_level.apply(centres(maps))
    assert np.linalg.norm(gaps, axis=1).max() < 0.3
    assert abs(found.enu_from_level.scale / enu_from_level.scale - 1) < 0.02
    # The tilt that was put in comes out, and no more.
    assert 0.1 < found.tilt_deg < 1.2
    assert found.diagnostics["score"] > 1.25 * found.diagnostics["second_score"]
    assert 1.3 < found.diagnostics["height_m"] < 1.9
    # Of two or three walls that are seen, a cell every two metres.
    assert 10 < found.diagnostics["key_point_cells"] < 200


def test_windows_without_depth_do_not_matter(walls: AirborneWalls) -> None:
    dark = [
        replace(m, depth=np.where(m.rgb[..., 0] < 80, np.nan, m.depth).astype(np.float32))
        for m in walk_round(houses(SITE), HOUSE)
    ]
    maps, enu_from_level = floated(dark)
    found = search_ground(maps, walls, QUICK, rng=np.random.default_rng(0)).decide()
    assert found.registered, found.reason
    assert found.enu_from_level is not None
    gaps = found.enu_from_level.apply(centres(maps)) - enu_from_level.apply(centres(maps))
    assert np.linalg.norm(gaps, axis=1).mean() < 0.3


def test_another_site_is_refused(walls: AirborneWalls) -> None:
    maps, _ = floated(walk_round(houses(SITE + 1), HOUSE))
    found = search_ground(maps, walls, QUICK, rng=np.random.default_rng(0)).decide()
    assert not found.registered
    assert found.reason


def test_a_model_without_walls_is_refused(walls: AirborneWalls) -> None:
    maps, _ = floated(walk_round(houses(SITE), HOUSE, count=2))
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in maps]
    found = search_ground(blind, walls, QUICK, rng=np.random.default_rng(0)).decide()
    assert not found.registered
    assert "no wall" in found.reason


def test_an_airborne_model_without_depth_is_an_error() -> None:
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in walk_round(houses(SITE), HOUSE, count=2)]
    with pytest.raises(DegenerateGeometry, match="from above"):
        airborne_walls(blind, rng=np.random.default_rng(0))


@pytest.mark.parametrize("aside_m", [0.9, 1.8])
def test_the_camera_that_was_moved_is_named(walls: AirborneWalls, aside_m: float) -> None:
    maps = walk_round(houses(SITE), HOUSE)
    pose = maps[5].camera.cam_from_world
    sideways = Similarity(1.0, pose.rotation, pose.translation + [aside_m, 0.0, 0.0])
    wrong = replace(maps[5], camera=Camera("wrong", maps[5].camera.intrinsics, sideways))
    pose_checks = check_poses_on_walls(
        [*maps[:5], wrong, *maps[6:]], walls, Similarity.identity(), rng=np.random.default_rng(0)
    )
    assert [w.image for w in pose_checks if w.contradicts] == ["wrong"]
    assert 0.8 * aside_m < pose_checks[5].offset_m < 1.5 * aside_m
    assert sum(w.tested for w in pose_checks) >= 6
    assert max(w.offset_m for w in pose_checks if w.tested and not w.contradicts) < 0.3
    assert all(w.best_score < 1.1 * w.score for w in pose_checks if w.tested and not w.contradicts)
