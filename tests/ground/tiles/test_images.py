# SPDX-License-Identifier: Apache-2.0
"""Pixels of photos and tiles know their points, and it is known which tile shows what."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.tiles import tile_px_for
from skymoor.ground.tiles.images import airborne_tiles, ground_photo, lift_pair, samples_of, shown_shares
from skymoor.ground.walls import transformed_depth_map
from skymoor.types import Matches2D
from support.tile_world import BOXES, PICTURES, PIXEL_M, TileWorld


@pytest.fixture(scope="module")
def world() -> TileWorld:
    return TileWorld()


def test_a_match_of_one_point_lifts_to_that_point(world: TileWorld) -> None:
    photo = ground_photo(world.walk(1)[0], PICTURES)
    shares = shown_shares(world.airborne, photo.known_level[None], PIXEL_M)[0]
    tile = world.airborne.tiles[int(shares.argmax())]
    rows, columns = np.nonzero(np.isfinite(photo.xyz_level[..., 0]))
    points = photo.xyz_level[rows, columns].astype(np.float64)
    px_b = world.airborne.px_from_enu(tile.render, points) - [tile.left, tile.top]
    px_a = np.column_stack([columns, rows]) + 0.5
    lifted = lift_pair(Matches2D(px_a, px_b, np.ones(len(px_a))), photo, tile)
    assert len(lifted) > 300
    gaps = np.linalg.norm(lifted.xyz_level - lifted.xyz_enu, axis=1)
    assert np.median(gaps) < 0.02
    # What a wall hides from the tile lies metres from what the tile shows there.
    assert np.mean(gaps > 2.0) < 1 - shares.max() + 0.1


def test_only_tiles_that_see_the_place_show_it(world: TileWorld) -> None:
    airborne = world.airborne
    east, north, _, half_north, height, heading = BOXES[0]
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    wall = np.array([[east, north, 0.6 * height]]) + half_north * np.array([[s, -c, 0.0]])  # looks south-east
    (shares,) = shown_shares(airborne, wall[None], 0.3)
    seeing = {airborne.tiles[k].render for k in np.flatnonzero(shares)}
    looks = {render: airborne.forward_enu(render) @ [s, -c, 0.0] for render in range(5)}
    assert seeing
    assert all(looks[render] < -0.1 for render in seeing)
    hidden = [k for k, tile in enumerate(airborne.tiles) if looks[tile.render] > 0.1]
    assert hidden and not shares[hidden].any()


def test_walls_are_upright_and_the_ground_is_not(world: TileWorld) -> None:
    nadir = [tile.upright for tile in world.airborne.tiles if tile.render == 0]
    oblique = [tile.upright for tile in world.airborne.tiles if tile.render != 0]
    assert max(nadir) < 0.05
    assert 0.1 < max(oblique) < 0.5


def test_edges_of_a_photo_have_no_point(world: TileWorld) -> None:
    depth_map = world.walk(1)[0]
    step = depth_map.depth.copy()
    step[:, 48:] *= 1.5
    whole, torn = (
        ground_photo(replace(depth_map, depth=d, sigma=0.005 * d), PICTURES) for d in (depth_map.depth, step)
    )
    assert np.isnan(torn.xyz_level[:, 47:49]).all()
    # Two columns go, next to the sky a few more.
    assert 0.9 < len(torn.known_level) / len(whole.known_level) < 1.0


def test_renders_in_another_frame_are_laid_into_enu(world: TileWorld) -> None:
    enu_from_render = Similarity(2.0, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([5.0, 6.0, 7.0]))
    moved = airborne_tiles(world.renders, PICTURES, enu_from_render=enu_from_render)
    tile, own = moved.tiles[0], world.airborne.tiles[0]
    assert moved.pixel_m == pytest.approx(2 * PIXEL_M, rel=0.02)
    points = own.xyz_enu[10:20, 10:20].reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(tile.xyz_enu[10:20, 10:20].reshape(-1, 3), enu_from_render.apply(points), atol=1e-3)
    np.testing.assert_allclose(
        moved.px_from_enu(0, enu_from_render.apply(points)), world.airborne.px_from_enu(0, points), atol=1e-6
    )


def test_blind_photos_and_empty_renders(world: TileWorld, rng: np.random.Generator) -> None:
    blind = replace(world.walk(1)[0], depth=np.full((72, 96), np.nan, np.float32))
    assert np.isnan(samples_of([ground_photo(blind, PICTURES)], 10, rng)).all()
    empty = [replace(render, confidence=np.zeros_like(render.confidence)) for render in world.renders]
    with pytest.raises(DegenerateGeometry, match="no render"):
        airborne_tiles(empty, PICTURES)


def test_tiles_show_as_much_as_photos(world: TileWorld) -> None:
    """A photo 96 pixels wide through a lens of 76 pixels shows 96/76 of its distance."""
    maps = world.walk(5)
    distance_m = np.median([np.nanmedian(m.depth) for m in maps])
    half = [transformed_depth_map(m, Similarity(0.5, np.eye(3), np.zeros(3))) for m in maps]
    for given, metres_per_unit in ((maps, 1.0), (half, 2.0)):
        side_px = tile_px_for(given, metres_per_unit, 0.01, least=1, most=10**6)
        assert side_px == pytest.approx(distance_m * 96 / 76 / 0.01, rel=0.1)
    assert tile_px_for(maps, 1.0, PIXEL_M) == 150
    assert tile_px_for(maps, 1.0, 1e-4) == 900
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in maps]
    assert tile_px_for(blind, 1.0, 0.1) == 150
