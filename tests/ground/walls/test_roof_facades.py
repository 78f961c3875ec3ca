# SPDX-License-Identifier: Apache-2.0
"""Walls in photos from above: their texture, their plane, what hides them, and how fine they are seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.ground.walls import Facade, FacadeOptions, HeightRaster, Wall, facade_of
from skymoor.ground.walls.roof_facades import RoofFacadeOptions, roof_facades
from skymoor.types import DepthMap
from support.houses import Houses, nearly_straight_down, turned

Array = NDArray[np.float64]

PIXEL_M = 0.1
HALF, HIGH_M = np.array([8.0, 6.0]), 7.0
BESIDE = np.array([[0.0, -14.0]])  # a tower before the south wall


def box(heading_deg: float = 0.0, *, with_tower: bool = False) -> Houses:
    middle, half, height = np.zeros((1, 2)), HALF[None], np.array([HIGH_M])
    if with_tower:
        middle, half = np.vstack([middle, BESIDE]), np.vstack([half, [[3.0, 3.0]]])
        height = np.array([HIGH_M, 14.0])
    return Houses(middle, half, height, np.full(len(middle), heading_deg), seed=5)


def south_wall(heading_deg: float = 0.0, *, moved_m: float = 0.0) -> Wall:
    """The wall of the box that faces south before it is turned; `moved_m` outwards of its place."""
    normal = (np.array([[0.0, -1.0]]) @ turned(heading_deg))[0]
    return Wall(normal, HALF[1] + moved_m, -HALF[0], HALF[0], 0.0, HIGH_M, 100.0)


def heights_of(world: Houses, cell_m: float = 0.5, half_m: float = 40.0) -> HeightRaster:
    """The exact heights seen from above."""
    at = np.arange(-half_m, half_m, cell_m) + cell_m / 2
    up = world.tops(np.stack(np.meshgrid(at, at), axis=-1)).astype(np.float32)
    return HeightRaster(up, np.zeros_like(up), np.ones(up.shape, dtype=bool), -half_m, -half_m, cell_m)


def from_the_south(world: Houses, nadir_deg: Sequence[float], heading_deg: float = 0.0) -> list[DepthMap]:
    """Photos of the middle of the south wall, without depths."""
    maps = nearly_straight_down(world, south_wall(heading_deg).centre, 180.0 - heading_deg, nadir_deg)
    return [replace(one, depth=np.full_like(one.depth, np.nan)) for one in maps]


def likeness(facade: Facade, texture: NDArray[np.uint8]) -> float:
    """Correlation with the first 16 m x 7 m of a texture, whose first row is at the ground."""
    border = round((facade.z1 - HIGH_M) / facade.pixel_m)
    part = np.s_[border : border + 70, border : border + 160]
    seen, shown = facade.raster.mask[part], facade.raster.rgb[part][..., 0].astype(float)
    assert seen.mean() > 0.9
    return float(np.corrcoef(shown[seen], texture[:70, :160][::-1][seen])[0, 1])


@pytest.mark.parametrize("heading_deg", [0.0, 33.0, 200.0])
def test_a_wall_shows_its_own_windows(heading_deg: float) -> None:
    world = box(heading_deg)
    (facade,) = roof_facades(
        [south_wall(heading_deg)], from_the_south(world, [16, 29], heading_deg), heights_of(world), PIXEL_M
    )
    own, *others = (likeness(facade, world._wall(k)) for k in range(4))
    assert own > 0.85
    assert max(others) < 0.6
    assert likeness(facade, world._wall(0)[:, :160][:, ::-1]) < 0.6


@pytest.mark.parametrize("moved_m", [-0.6, 0.0, 0.6, 1.0])
def test_a_plane_comes_back_to_where_two_elevations_agree(moved_m: float) -> None:
    world, wall = box(), south_wall(moved_m=moved_m)
    (facade,) = roof_facades([wall], from_the_south(world, [18, 28]), heights_of(world), PIXEL_M)
    assert facade.wall.offset == pytest.approx(HALF[1], abs=0.25)
    assert likeness(facade, world._wall(0)) > 0.7
    assert (facade.wall.s0, facade.wall.s1, facade.wall.z1) == (wall.s0, wall.s1, wall.z1)


@pytest.mark.parametrize("nadir_deg", [[18.0], [28.0], [23.5, 24.5]])
def test_a_plane_stays_under_one_elevation(nadir_deg: list[float]) -> None:
    world, wall = box(), south_wall(moved_m=0.6)
    (facade,) = roof_facades([wall], from_the_south(world, nadir_deg), heights_of(world), PIXEL_M)
    assert facade.wall.offset == wall.offset
    assert likeness(facade, world._wall(0)) < 0.5


def test_a_plane_stays_without_the_parallax_that_is_asked_for() -> None:
    world, wall = box(), south_wall(moved_m=0.6)
    maps, heights = from_the_south(world, [18, 28]), heights_of(world)  # tangents of 3.1 and 1.9
    (enough,) = roof_facades([wall], maps, heights, PIXEL_M, RoofFacadeOptions(min_parallax=1.0))
    (too_little,) = roof_facades([wall], maps, heights, PIXEL_M, RoofFacadeOptions(min_parallax=1.4))
    assert enough.wall.offset == pytest.approx(HALF[1], abs=0.25)
    assert too_little.wall.offset == wall.offset


def test_a_plane_stays_where_the_photos_show_nothing_to_compare() -> None:
    world, wall = box(), south_wall(moved_m=0.6)
    noise = np.random.default_rng(0)
    maps = [
        replace(one, rgb=np.clip(noise.normal(128, 8, one.rgb.shape), 0, 255).astype(np.uint8))
        for one in from_the_south(world, [18, 28])
    ]
    (facade,) = roof_facades([wall], maps, heights_of(world), PIXEL_M)
    assert facade.wall.offset == wall.offset


def test_what_a_higher_box_hides_is_masked() -> None:
    world, wall = box(with_tower=True), south_wall()
    exact = nearly_straight_down(world, wall.centre, 180.0, [24])
    (facade,) = roof_facades([wall], from_the_south(world, [24]), heights_of(world), PIXEL_M)
    s = facade.s0 + PIXEL_M * (np.arange(facade.raster.mask.shape[1]) + 0.5)
    z = facade.z1 - PIXEL_M * (np.arange(facade.raster.mask.shape[0]) + 0.5)
    mask = facade.raster.mask
    behind, aside, above, low = np.abs(s) < 2.0, (np.abs(s) > 5.0) & (np.abs(s) < 8.0), (z > 5.0) & (z < 7.0), z < 1.0
    assert not mask[np.ix_(low & (z > 0), behind)].any()
    assert mask[np.ix_((z > 0) & (z < 7.0), aside)].all()
    assert mask[np.ix_(above, np.abs(s) < 8.0)].all()
    # The exact depths of the photo say the same, but for what a coarse test of the heights gives away at its edge.
    truth = facade_of(wall, exact, PIXEL_M, FacadeOptions(margin_m=0.5, tolerance_m=0.3)).raster.mask
    inner = np.ix_((z > 0.3) & (z < 6.7), np.abs(s) < 7.7)
    assert (truth[inner] == mask[inner]).mean() > 0.85
    assert not (truth[inner] & ~mask[inner]).mean() > 0.02
    without = roof_facades([wall], from_the_south(world, [24]), heights_of(box()), PIXEL_M)[0].raster.mask
    assert without[inner].all()


def test_flat_coarse_and_hardly_seen_walls_are_dropped() -> None:
    world, wall = box(), south_wall()
    heights = heights_of(world)
    flat, steep = from_the_south(world, [6]), from_the_south(world, [14])
    assert roof_facades([wall], flat, heights, PIXEL_M) == []
    assert len(roof_facades([wall], flat, heights, PIXEL_M, RoofFacadeOptions(min_cosine=0.05))) == 1
    assert len(roof_facades([wall], steep, heights, PIXEL_M)) == 1
    assert roof_facades([wall], steep, heights, PIXEL_M, RoofFacadeOptions(max_detail_m=0.15)) == []
    assert len(roof_facades([wall], steep, heights, PIXEL_M, RoofFacadeOptions(max_detail_m=0.4))) == 1
    assert roof_facades([wall], steep, heights, PIXEL_M, RoofFacadeOptions(min_seen_m2=150.0)) == []
    away = replace(wall, normal=-wall.normal)
    assert roof_facades([away], steep, heights, PIXEL_M) == []
    assert roof_facades([wall], [], heights, PIXEL_M) == []


@pytest.mark.parametrize(("nadir_deg", "azimuth_deg"), [(15.0, 180.0), (29.0, 180.0), (29.0, 200.0), (60.0, 180.0)])
def test_the_detail_is_the_size_of_the_photo_s_pixels_on_the_wall(nadir_deg: float, azimuth_deg: float) -> None:
    wall = south_wall()
    (photo,) = nearly_straight_down(box(), wall.centre, azimuth_deg, [nadir_deg])
    detail_m = facade_of(wall, [photo], PIXEL_M).detail_m
    camera, step_m = photo.camera, 0.1
    ends = wall.centre + step_m * np.array([np.zeros(3), [*wall.right, 0.0], [0.0, 0.0, 1.0]])
    xyz = camera.cam_from_world.apply(ends)
    px = xyz[:, :2] / xyz[:, 2:] * camera.intrinsics.fx
    along, upwards = step_m / np.linalg.norm(px[1:] - px[0], axis=1)
    assert detail_m == pytest.approx((along, upwards), rel=0.2)
    assert detail_m[1] > detail_m[0]


def test_the_detail_is_that_of_the_photo_that_shows_most() -> None:
    wall, world = south_wall(), box()
    sharp = nearly_straight_down(world, wall.centre, 180.0, [29], focal_px=1800.0)
    wide = nearly_straight_down(world, wall.centre, 180.0, [29], focal_px=600.0)
    # The sharp one holds a part of the wall only.
    aside = nearly_straight_down(world, wall.centre + [13.0, 0.0, 0.0], 180.0, [29], focal_px=1800.0)
    assert facade_of(wall, [*sharp, *wide], PIXEL_M).detail_m == facade_of(wall, sharp, PIXEL_M).detail_m
    assert facade_of(wall, [*aside, *wide], PIXEL_M).detail_m == facade_of(wall, wide, PIXEL_M).detail_m
    assert np.isnan(facade_of(wall, [], PIXEL_M).detail_m).all()
