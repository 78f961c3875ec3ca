# SPDX-License-Identifier: Apache-2.0
"""Walls of an airborne component come from its depth maps where these show them, and from its roof edges elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skymoor.geo import EnuFrame, Grid
from skymoor.geometry import Similarity
from skymoor.ground.walls import AirborneModel, AirborneWalls, airborne_walls, walls_of_components
from skymoor.ground.walls.airborne import transformed_depth_map
from skymoor.ground.walls.roof_edges import SurfaceImage
from skymoor.types import DepthMap, Photos, Reference, Render, View
from support.houses import Houses, nearly_straight_down

BOX = Houses(np.array([[1.0, 2.0]]), np.array([[8.0, 6.0]]), np.array([7.0]), np.array([25.0]), seed=5)
GRID = Grid(-25.0, 25.0, 0.25, (200, 200))


@lru_cache(maxsize=1)
def flight() -> list[DepthMap]:
    """Two photos from each side."""
    middle = np.array([*BOX.middle[0], 3.0])
    return [one for k in range(4) for one in nearly_straight_down(BOX, middle, 65.0 + 90 * k, [18, 29])]


def smoothed(maps: list[DepthMap]) -> list[DepthMap]:
    """Depth maps that know roof and ground and nothing between."""
    found = []
    for one in maps:
        i = one.camera.intrinsics
        u, v = np.meshgrid(np.arange(i.width) + 0.5, np.arange(i.height) + 0.5)
        rays = i.rays(np.column_stack([u.ravel(), v.ravel()])) @ one.camera.cam_from_world.rotation
        up = (one.camera.centre[2] + one.depth.ravel() * rays[:, 2]).reshape(one.depth.shape)
        level = (up < 0.05) | (up > 6.95)
        found.append(replace(one, depth=np.where(level, one.depth, np.nan).astype(np.float32)))
    return found


def pictures() -> list[DepthMap]:
    return [replace(one, depth=np.full_like(one.depth, np.nan)) for one in flight()]


def from_above() -> SurfaceImage:
    up = BOX.tops(GRID.centres()).astype(np.float32)
    grey = np.where(up > 0, 170, 100) + np.random.default_rng(0).normal(scale=4, size=up.shape)
    rgb = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=-1)
    return SurfaceImage(GRID, rgb, up, np.ones(up.shape, dtype=bool))


def check_sides(found: AirborneWalls) -> None:
    """One facade for each side of the box, where it is."""
    normals = np.array([facade.wall.normal for facade in found.facades])
    headings = np.sort(np.degrees(np.arctan2(normals[:, 1], normals[:, 0])) % 360)
    np.testing.assert_allclose(headings, [25, 115, 205, 295], atol=1.5)
    for facade in found.facades:
        across = BOX.half[0][0 if abs(facade.wall.normal @ found_right()) > 0.7 else 1]
        assert facade.wall.offset - BOX.middle[0] @ facade.wall.normal == pytest.approx(across, abs=0.3)
        assert facade.raster.mask.mean() > 0.5


def found_right() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Direction of the long sides."""
    return np.array([np.cos(np.radians(25.0)), np.sin(np.radians(25.0))])


def test_roof_edges_give_the_walls_that_depth_maps_do_not_show() -> None:
    maps = smoothed(flight())
    alone = airborne_walls(maps, rng=np.random.default_rng(0))
    assert not alone.facades
    calls = []

    def progress(done: int, total: int, _: str = "") -> None:
        calls.append((done, total))

    found = airborne_walls(
        maps,
        surfaces=[from_above()],
        pictures_enu=pictures(),
        rng=np.random.default_rng(0),
        progress=progress,
    )
    check_sides(found)
    assert calls[-1] == (4, 4)
    blind = airborne_walls(maps, surfaces=[from_above()], rng=np.random.default_rng(0))
    assert not blind.facades


def test_walls_of_the_depth_maps_are_not_repeated_by_roof_edges() -> None:
    maps, rng = flight(), np.random.default_rng(0)
    alone = airborne_walls(maps, rng=np.random.default_rng(0))
    check_sides(alone)
    both = airborne_walls(maps, surfaces=[from_above(), from_above()], pictures_enu=pictures(), rng=rng)
    check_sides(both)
    assert [f.wall.offset for f in both.facades] == [f.wall.offset for f in alone.facades]


def flat_model(enu_from_level: Similarity) -> tuple[AirborneModel, Photos]:
    """The box's photos with a nadir render that knows the ground only, in another frame, and how to read them."""
    level_from_enu = enu_from_level.inverse()
    maps = [transformed_depth_map(one, level_from_enu) for one in smoothed(flight())]
    rows, columns = np.indices(GRID.shape)
    enu = np.stack([GRID.east0 + (columns + 0.5) * 0.25, GRID.north0 - (rows + 0.5) * 0.25, 0.0 * rows], axis=-1)
    pixel = 0.25 * level_from_enu.scale
    corner = level_from_enu.apply(np.array([[GRID.east0, GRID.north0, 0.0]]))[0]
    view = View(np.diag([1.0, -1.0, -1.0]), corner[0] + pixel / 2, -corner[1] + pixel / 2, pixel, GRID.shape)
    rgb = np.full((*GRID.shape, 3), 100, np.uint8)
    render = Render(view, rgb, level_from_enu.apply(enu).astype(np.float32), np.ones(GRID.shape, np.float32))
    images = {one.camera.image: one.rgb for one in flight()}
    sizes = tuple((rgb.shape[1], rgb.shape[0]) for rgb in images.values())
    cameras = [one.camera for one in maps]
    return AirborneModel(maps, cameras, render, enu_from_level), Photos(tuple(images), sizes, images.__getitem__)


def test_a_fine_dsm_gives_the_roof_edges_that_the_model_does_not_show() -> None:
    model, photos = flat_model(Similarity(5.0, np.eye(3), np.array([3.0, -2.0, 1.0])))
    above, frame = from_above(), EnuFrame(47.0, 8.0, 400.0)
    reference = Reference(frame, GRID, above.rgb, above.seen, above.up, np.eye(3), 0.5)
    alone = walls_of_components([model], photos)
    assert alone is not None and not alone.facades
    with_dsm = walls_of_components([model], photos, reference=reference)
    assert with_dsm is not None
    check_sides(with_dsm)
    coarse = walls_of_components([model], photos, reference=replace(reference, dsm_pixel_m=30.0))
    assert coarse is not None and not coarse.facades


def test_the_plan_is_that_of_the_largest_surface_or_of_the_heights() -> None:
    maps = smoothed(flight())
    given = airborne_walls(maps, surfaces=[from_above()], rng=np.random.default_rng(0)).plan
    assert given.grid == Grid(-25.0, 25.0, 0.75, given.known.shape)
    own = airborne_walls(maps, rng=np.random.default_rng(0)).plan
    assert own.grid.pixel_m == 1.0
    for plan in (given, own):
        tops = BOX.tops(plan.grid.centres())
        inner = BOX.tops(plan.grid.centres() + [2.0, 0.0]) * BOX.tops(plan.grid.centres() - [2.0, 0.0]) > 0
        assert plan.raised[inner].mean() > 0.9
        houses = plan.raised > 0.5
        assert (houses & (tops > 0)).sum() > 0.85 * (houses | (tops > 0)).sum()
        assert plan.raised[(tops == 0) & plan.known].mean() < 0.1
        # Steps point away from the middle.
        arms = plan.grid.centres() - BOX.middle[0]
        outwards = arms[..., 0] * plan.steps[0] - arms[..., 1] * plan.steps[1]
        strong = np.hypot(*plan.steps) > 0.1
        assert strong.sum() > 40
        assert (outwards[strong] > 0).mean() > 0.98
