# SPDX-License-Identifier: Apache-2.0
"""The two sides of the search: ground photos and tiles of the airborne renders, each pixel with its point in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.errors import DegenerateGeometry
from skymoor.geo import sample
from skymoor.geometry import Similarity
from skymoor.model import tiles
from skymoor.types import Array, Array32, DepthMap, Mask, Matches2D, Matches3D, Raster, Render, View


@dataclass(frozen=True)
class TileImageOptions:
    """Tiles of the renders, and which pixels have a usable point.

    Attributes:
        tile_px, overlap: of the tiles (the paper's).
        min_confidence: of the render.
        max_step_m: neighbouring pixels of a render farther apart than this are an edge.
        max_sigma_ratio: depths of photos less certain than this share of themselves are not used.
        max_step_ratio: neighbouring depths of a photo that differ by more than this share are an edge.
    """

    tile_px: int = 300
    overlap: float = 0.25
    min_confidence: float = 0.2
    max_step_m: float = 1.5
    max_sigma_ratio: float = 0.03
    max_step_ratio: float = 0.08


@dataclass(frozen=True, eq=False)
class GroundPhoto:
    """A levelled photo: its name, its raster, points (h, w, 3) or NaN, and its viewing direction (3,)."""

    image: str
    raster: Raster
    xyz_level: Array32
    forward_level: Array

    @property
    def known_level(self) -> Array:
        """The points (n, 3) that are known."""
        return np.asarray(self.xyz_level[np.isfinite(self.xyz_level[..., 0])], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Tile:
    """A window of render `render` with its top left pixel at (`top`, `left`), points (h, w, 3) in ENU metres or NaN.

    `coverage` is the share of its pixels that have a point, `upright` the share that show walls.
    """

    render: int
    top: int
    left: int
    raster: Raster
    xyz_enu: Array32
    coverage: float
    upright: float


@dataclass(frozen=True, eq=False)
class AirborneTiles:
    """All tiles of all renders, with the whole renders' points (h, w, 3) in ENU metres, their views, and the way back.

    `pixel_m` is the size of a render's pixel.
    """

    tiles: tuple[Tile, ...]
    views: tuple[View, ...]
    xyz_enu: tuple[Array32, ...]
    render_from_enu: Similarity
    pixel_m: float

    def forward_enu(self, render: int) -> Array:
        """Viewing direction (3,) of a render."""
        return np.asarray(self.render_from_enu.rotation.T @ self.views[render].view_from_level[2])

    def px_from_enu(self, render: int, xyz_enu: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in a render."""
        view = self.views[render]
        xy = self.render_from_enu.apply(xyz_enu) @ view.view_from_level[:2].T
        return np.asarray((xy - [view.x0, view.y0]) / view.pixel)


def tile_px_for(
    maps_level: Sequence[DepthMap], metres_per_unit: float, pixel_m: float, *, least: int = 150, most: int = 900
) -> int:
    """The side of tiles that cover about as much as photos do (paper, section 3.4, tiling of airborne renders).

    Args:
        maps_level: photos with their depth, in the unit that `metres_per_unit` is of.
        metres_per_unit: by metric depth.
        pixel_m: size of a render's pixel.
        least, most: pixels.
    """
    widths = [
        float(np.nanmedian(m.depth)) * max(m.depth.shape) / m.camera.intrinsics.fx
        for m in maps_level
        if np.isfinite(m.depth).any()
    ]
    side_px = float(np.median(widths)) * metres_per_unit / pixel_m if widths else 0.0
    return int(np.clip(round(side_px), least, most))


def ground_photo(depth_map: DepthMap, options: TileImageOptions | None = None) -> GroundPhoto:
    """A levelled photo for matching, with the points of its pixels."""
    options = options or TileImageOptions()
    depth, camera = depth_map.depth, depth_map.camera
    with np.errstate(invalid="ignore"):
        good = (depth_map.sigma <= options.max_sigma_ratio * depth) & (depth > 0)
        good &= _range(depth[..., None]) <= options.max_step_ratio * depth
    u, v = np.meshgrid(np.arange(depth.shape[1]) + 0.5, np.arange(depth.shape[0]) + 0.5)
    rays = camera.intrinsics.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation
    xyz = camera.centre + np.where(good, depth, np.nan)[..., None] * rays.reshape(*depth.shape, 3)
    raster = Raster(depth_map.rgb, np.ones(depth.shape, bool))
    return GroundPhoto(camera.image, raster, xyz.astype(np.float32), camera.cam_from_world.rotation[2])


def airborne_tiles(
    renders: Sequence[Render], options: TileImageOptions | None = None, *, enu_from_render: Similarity | None = None
) -> AirborneTiles:
    """Cut renders into tiles.

    Args:
        renders: of the airborne model, with points in the frame that `enu_from_render` leads from.
        options: see there.
        enu_from_render: by default the renders are in ENU metres.

    Raises `DegenerateGeometry` where no render shows anything.
    """
    options = options or TileImageOptions()
    enu_from_render = enu_from_render or Similarity.identity()
    cut: list[Tile] = []
    points = []
    for k, render in enumerate(renders):
        shown = (render.confidence >= options.min_confidence) & np.isfinite(render.xyz).all(axis=2)
        xyz = enu_from_render.apply(np.where(shown[..., None], render.xyz, np.nan)).astype(np.float32)
        xyz[~(_range(xyz) <= options.max_step_m)] = np.nan
        points.append(xyz)
        walls = _upright(xyz)
        for rows, columns in tiles(render.view.shape, size=options.tile_px, overlap=options.overlap):
            part = xyz[rows, columns]
            coverage = float(np.isfinite(part[..., 0]).mean())
            raster = Raster(render.rgb[rows, columns], shown[rows, columns])
            upright = float(walls[rows, columns].mean())
            cut.append(Tile(k, rows.start, columns.start, raster, part, coverage, upright))
    if not any(tile.coverage for tile in cut):
        raise DegenerateGeometry("no render shows a point of the airborne model with enough confidence")
    pixel_m = float(np.median([r.view.pixel for r in renders])) * enu_from_render.scale
    return AirborneTiles(tuple(cut), tuple(r.view for r in renders), tuple(points), enu_from_render.inverse(), pixel_m)


def lift_pair(matches: Matches2D, photo: GroundPhoto, tile: Tile) -> Matches3D:
    """Points of both sides for matches from a photo (a) to a tile (b); those without a point on both are dropped."""
    h, w = photo.raster.mask.shape
    column, row = np.floor(matches.px_a).astype(np.intp).T
    xyz_level = photo.xyz_level[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)].astype(np.float64)
    xyz_enu = np.column_stack([sample(tile.xyz_enu[..., axis], matches.px_b) for axis in range(3)])
    good = np.isfinite(xyz_level).all(axis=1) & np.isfinite(xyz_enu).all(axis=1)
    return Matches3D(xyz_level, xyz_enu, matches).take(good)


def samples_of(photos: Sequence[GroundPhoto], count: int, rng: np.random.Generator) -> Array:
    """Known points (n photos, count, 3) of each photo, drawn at random; NaN for a photo without any."""
    drawn = np.full((len(photos), count, 3), np.nan)
    for k, photo in enumerate(photos):
        known = photo.known_level
        if len(known):
            drawn[k] = known[rng.integers(0, len(known), count)]
    return drawn


def shown_shares(airborne: AirborneTiles, points_enu: Array, reach_m: float) -> Array:
    """Share (n photos, n tiles) of each photo's points (n photos, count, 3) that a tile shows where they are.

    A point counts where the render's own point at its pixel is within `reach_m`: neither hidden, nor absent.
    """
    shares = np.zeros((len(points_enu), len(airborne.tiles)))
    for render, xyz in enumerate(airborne.xyz_enu):
        px = airborne.px_from_enu(render, np.nan_to_num(points_enu, nan=1e6))
        column, row = np.moveaxis(np.floor(px), -1, 0)
        h, w = xyz.shape[:2]
        inside = (row >= 0) & (column >= 0) & (row < h) & (column < w)
        shown_enu = xyz[np.where(inside, row, 0).astype(np.intp), np.where(inside, column, 0).astype(np.intp)]
        with np.errstate(invalid="ignore"):
            shown = inside & (np.linalg.norm(shown_enu - points_enu, axis=-1) <= reach_m)
        own = [k for k, tile in enumerate(airborne.tiles) if tile.render == render]
        top, left, height, width = np.array(
            [(t.top, t.left, *t.raster.mask.shape) for t in (airborne.tiles[k] for k in own)]
        ).T
        down, across = row[..., None] - top, column[..., None] - left
        within = (down >= 0) & (down < height) & (across >= 0) & (across < width)
        shares[:, own] = (within & shown[..., None]).mean(axis=1)
    return shares


def _upright(xyz: Array32, *, reach_px: int = 4, max_up: float = 0.4) -> Mask:
    """Where (h, w) the surface of a render stands upright, by normals over `reach_px` to all sides."""
    inner = slice(reach_px, -reach_px)
    across = xyz[inner, 2 * reach_px :] - xyz[inner, : -2 * reach_px]
    down = xyz[2 * reach_px :, inner] - xyz[: -2 * reach_px, inner]
    normals = np.cross(across, down)
    with np.errstate(invalid="ignore"):
        found = np.abs(normals[..., 2]) < max_up * np.linalg.norm(normals, axis=-1)
    upright = np.zeros(xyz.shape[:2], bool)
    upright[inner, inner] = found
    return upright


def _range(values: Array32) -> Array32:
    """Largest difference (h, w) within 3 x 3 pixels in any of the channels (h, w, c); inf next to what is not known."""
    known = np.asarray(np.isfinite(values).all(axis=2))
    kernel, far = np.ones((3, 3), np.uint8), np.float32(1e9)
    steps = []
    for k in range(values.shape[2]):
        high = cv2.dilate(np.where(known, values[..., k], -far).astype(np.float32), kernel)
        low = cv2.erode(np.where(known, values[..., k], far).astype(np.float32), kernel)
        steps.append(high - low)
    return np.where(known, np.max(steps, axis=0), np.inf).astype(np.float32)
