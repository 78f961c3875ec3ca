# SPDX-License-Identifier: Apache-2.0
"""Walls of known houses are found below their roof edges, and none below trees and hills."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from skymoor.geo import Grid
from skymoor.ground.walls import Wall
from skymoor.ground.walls.roof_edges import RoofEdgeOptions, SurfaceImage, roof_edge_walls, without_repeated
from support.houses import turned

Array = NDArray[np.float64]

GRID = Grid(-30.0, 30.0, 0.25, (240, 240))
TOP_M = 7.0
# Counter-clockwise, so that the outside is to the right of each side.
BOX = np.array([[-8.0, -6.0], [8.0, -6.0], [8.0, 6.0], [-8.0, 6.0]])
L_SHAPE = np.array([[-10.0, -9.0], [10.0, -9.0], [10.0, 0.0], [0.0, 0.0], [0.0, 9.0], [-10.0, 9.0]])
PLAIN = np.full((*GRID.shape, 3), 100, np.uint8)
ALL = np.ones(GRID.shape, dtype=bool)


def coloured(bright: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """A noisy picture that is brighter where `bright`."""
    noise = np.random.default_rng(0).normal(scale=4.0, size=bright.shape)
    grey = np.clip(np.where(bright, 170, 100) + noise, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def covered(outline: Array) -> NDArray[np.bool_]:
    """Pixels at least half of which are inside an outline (n, 2)."""
    fine = np.zeros((4 * GRID.shape[0], 4 * GRID.shape[1]), np.uint8)
    px = 4 * GRID.px_from_enu(outline) - 0.5
    cv2.fillPoly(fine, [np.round(16 * px).astype(np.int32)], 255, shift=4)
    return np.asarray(cv2.resize(fine, GRID.shape[::-1], interpolation=cv2.INTER_AREA) > 127)


def house(outline: Array, slope: tuple[float, float] = (0.0, 0.0)) -> SurfaceImage:
    """A house with a flat roof on ground that rises by `slope` to the east and to the north."""
    inside = covered(outline)
    up = np.where(inside, TOP_M, GRID.centres() @ np.array(slope)).astype(np.float32)
    return SurfaceImage(GRID, coloured(inside), up, ALL)


def check_walls(walls: list[Wall], outline: Array, slope: tuple[float, float] = (0.0, 0.0)) -> None:
    """Each side of the outline has its wall, and there is no other."""
    assert len(walls) == len(outline)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        outwards = np.array([along[1], -along[0]])
        off = [abs(wall.offset - a @ outwards) if wall.normal @ outwards > 0.999 else np.inf for wall in walls]
        wall = walls[int(np.argmin(off))]
        assert min(off) < GRID.pixel_m
        ends = np.sort([a @ wall.right, b @ wall.right])
        np.testing.assert_allclose([wall.s0, wall.s1], ends, atol=0.8)
        foot = np.sort([a @ slope, b @ slope])
        assert foot[0] - 0.3 < wall.z0 < foot[1] + 0.3
        assert wall.z1 == pytest.approx(TOP_M, abs=0.3)
        assert 0.8 < wall.area_m2 / ((wall.s1 - wall.s0) * (wall.z1 - wall.z0)) <= 1 + 1e-9


@pytest.mark.parametrize("heading_deg", [0.0, 17.0, 41.0, 253.0])
@pytest.mark.parametrize("outline", [BOX, L_SHAPE], ids=["box", "L"])
def test_every_side_of_a_house_is_a_wall(outline: Array, heading_deg: float) -> None:
    outline = outline @ turned(heading_deg)
    check_walls(roof_edge_walls(house(outline)), outline)


@pytest.mark.parametrize("slope", [(0.03, -0.02), (-0.01, 0.04)])
def test_walls_reach_down_to_sloping_ground(slope: tuple[float, float]) -> None:
    outline = BOX @ turned(17.0)
    check_walls(roof_edge_walls(house(outline, slope)), outline, slope)


def test_the_longest_walls_come_first() -> None:
    lengths = [wall.area_m2 / (wall.z1 - wall.z0) for wall in roof_edge_walls(house(L_SHAPE))]
    assert lengths == sorted(lengths, reverse=True)
    few = roof_edge_walls(house(L_SHAPE), RoofEdgeOptions(max_walls=2))
    assert [wall.normal.round().tolist() for wall in few] == [[0, -1], [-1, 0]]


def test_a_straight_row_of_trees_is_no_wall() -> None:
    row = covered(np.array([[-25.0, -2.5], [25.0, -2.5], [25.0, 2.5], [-25.0, 2.5]]) @ turned(23.0))
    noise = np.random.default_rng(1).normal(size=GRID.shape)

    def found(rough_m: float) -> int:
        up = np.where(row, TOP_M + rough_m * noise, 0.0).astype(np.float32)
        return len(roof_edge_walls(SurfaceImage(GRID, coloured(row), up, ALL)))

    assert found(2.0) == 0
    # The same with a smooth top is a wall on both long sides, whatever is found of the ends.
    assert 2 <= found(0.3) <= 4


def test_scattered_trees_are_no_walls() -> None:
    rng = np.random.default_rng(4)
    crowns = np.zeros(GRID.shape)
    for east, north, radius, height in rng.uniform([-24, -24, 2, 6], [24, 24, 4, 12], (25, 4)):
        out = np.linalg.norm(GRID.centres() - [east, north], axis=-1) / radius
        crowns = np.maximum(crowns, np.where(out < 1, height * np.sqrt(np.maximum(1 - 0.7 * out**2, 0)), 0))
    up = np.where(crowns > 0, np.maximum(crowns + rng.normal(scale=1.5, size=GRID.shape), 0.5), 0.0)
    assert roof_edge_walls(SurfaceImage(GRID, coloured(crowns > 0), up.astype(np.float32), ALL)) == []


def test_lines_on_a_smooth_hill_are_no_walls() -> None:
    out = np.linalg.norm(GRID.centres(), axis=-1)
    hill = (6.0 * np.exp(-0.5 * (out / 14.0) ** 2)).astype(np.float32)
    lines = house(BOX @ turned(23.0))
    assert roof_edge_walls(replace(lines, up=hill)) == []
    assert len(roof_edge_walls(lines)) == 4


def test_smeared_heights_give_the_wall_below_the_line_of_the_picture() -> None:
    outline = BOX @ turned(23.0)
    sharp = house(outline)
    out_m = distance_transform_edt(sharp.up < 0.5 * TOP_M) * GRID.pixel_m
    smeared = replace(sharp, up=(TOP_M * np.maximum(1 - out_m / 3.0, 0)).astype(np.float32))
    check_walls(roof_edge_walls(smeared), outline)
    # The heights alone do not tell where it is.
    alone = roof_edge_walls(replace(smeared, rgb=PLAIN))
    assert not any(abs(wall.offset - side_m) < 0.5 for wall in alone for side_m in (6.0, 8.0))


def test_without_heights_there_are_no_walls() -> None:
    sharp = house(BOX)
    unknown = np.full(GRID.shape, np.nan, np.float32)
    assert roof_edge_walls(replace(sharp, up=unknown)) == []


@pytest.mark.parametrize("up_m", [0.0, np.nan])
def test_without_any_line_there_are_no_walls(up_m: float) -> None:
    assert roof_edge_walls(SurfaceImage(GRID, PLAIN, np.full(GRID.shape, up_m, np.float32), ALL)) == []


def test_walls_without_heights_on_one_side_are_left_out() -> None:
    sharp = house(BOX)
    west_unknown = np.where(GRID.centres()[..., 0] < -8.0, np.nan, sharp.up).astype(np.float32)
    normals = [wall.normal for wall in roof_edge_walls(replace(sharp, up=west_unknown))]
    assert len(normals) == 3
    assert all(normal[0] > -0.1 for normal in normals)


def test_low_steps_are_no_walls() -> None:
    sharp = house(BOX)
    low = replace(sharp, up=sharp.up * np.float32(1.5 / TOP_M))
    assert roof_edge_walls(low) == []
    assert len(roof_edge_walls(low, RoofEdgeOptions(min_step_m=1.0))) == 4


def test_repeated_walls_are_dropped() -> None:
    options = RoofEdgeOptions()
    wall = Wall(np.array([0.0, -1.0]), 6.0, -8.0, 8.0, 0.0, 7.0, 100.0)
    beside = replace(wall, offset=8.0, s0=-6.0)
    opposite = replace(wall, normal=np.array([0.0, 1.0]))
    farther = replace(wall, offset=10.0)
    next_door = replace(wall, s0=9.0, s1=20.0)
    above = replace(wall, z0=6.0, z1=11.0)
    others = [opposite, farther, next_door, above]
    assert without_repeated([wall, beside, *others], (), options) == [wall, *others]
    assert without_repeated([beside, wall], (), options) == [beside]
    assert without_repeated([beside, farther], [wall], options) == [farther]
