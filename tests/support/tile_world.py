# SPDX-License-Identifier: Apache-2.0
"""Boxes seen from the ground and from the air with exact points, and a matcher that answers from these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.engines.raycast import RayCaster
from skymoor.geometry import Intrinsics, Similarity
from skymoor.ground.tiles import TileImageOptions
from skymoor.ground.tiles.images import AirborneTiles, airborne_tiles, ground_photo
from skymoor.ground.walls import transformed_depth_map
from skymoor.model import RenderOptions, nadir_view, oblique_views
from skymoor.simulate.oracles import OracleMatcher
from skymoor.types import Array32, Camera, DepthMap, Image, Raster, Render, View, Warp
from support.blocks import look_at

Array = NDArray[np.float64]

LENS = Intrinsics(96, 72, 76.0, 76.0, 48.0, 36.0)
PICTURES = TileImageOptions(tile_px=64)
PIXEL_M = 0.33
HALF_M = 34.0
# Middle east and north, half sizes, height, heading in degrees.
BOXES = ((-14.0, -12.0, 7.0, 5.0, 8.0, 20.0), (15.0, -10.0, 5.0, 8.0, 6.0, 65.0), (2.0, 16.0, 9.0, 4.0, 10.0, -15.0))


@dataclass(frozen=True)
class TileWorld:
    """Three boxes on flat ground, 68 m wide."""

    @cached_property
    def caster(self) -> RayCaster:
        vertices = [np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [HALF_M, HALF_M, 0]]
        triangles = [[0, 1, 2], [0, 2, 3]]
        for east, north, a, b, height, heading in BOXES:
            turn = Rotation.from_euler("z", heading, degrees=True).as_matrix()[:2, :2]
            plan = np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) @ turn.T + [east, north]
            first = sum(map(len, vertices))
            vertices += [np.column_stack([plan, np.full(4, z)]) for z in (0.0, height)]
            for k in range(4):
                p, q = first + k, first + (k + 1) % 4
                triangles += [[p, q, q + 4], [p, q + 4, p + 4]]
            triangles += [[first + 4, first + 5, first + 6], [first + 4, first + 6, first + 7]]
        return RayCaster(np.concatenate(vertices).astype(np.float32), np.array(triangles, np.uint32), threads=1)

    def photo(self, name: str, centre: Array, target: Array) -> DepthMap:
        """A photo with exact depth."""
        camera = Camera(name, LENS, look_at(centre, target))
        u, v = np.meshgrid(np.arange(LENS.width) + 0.5, np.arange(LENS.height) + 0.5)
        rays = LENS.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation
        depth = self.caster.cast(centre.astype(np.float32), rays.astype(np.float32)).reshape(u.shape)
        depth[~np.isfinite(depth)] = np.nan
        xyz = centre + depth[..., None] * rays.reshape(*u.shape, 3)
        return DepthMap(camera, depth, 0.005 * depth, np.full(u.shape, 3, np.uint8), painted(xyz))

    def render(self, view: View) -> Render:
        """An exact render."""
        h, w = view.shape
        x, y = np.meshgrid(view.x0 + (np.arange(w) + 0.5) * view.pixel, view.y0 + (np.arange(h) + 0.5) * view.pixel)
        origins = np.stack([x, y, np.full((h, w), -100.0)], axis=-1) @ view.view_from_level
        along = np.broadcast_to(view.view_from_level[2], origins.shape)
        t = self.caster.cast(origins.astype(np.float32), along.astype(np.float32))
        xyz = (origins + np.where(np.isfinite(t), t, np.nan)[..., None] * along).astype(np.float32)
        return Render(view, painted(xyz), xyz, np.isfinite(t).astype(np.float32))

    @cached_property
    def renders(self) -> list[Render]:
        """From above and from four sides, in ENU metres."""
        corners = np.array([[e, n, z] for e in (-HALF_M, HALF_M) for n in (-HALF_M, HALF_M) for z in (0.0, 10.0)])
        options = RenderOptions(obliques=4, border_percent=0.0)
        views = [nadir_view(corners, PIXEL_M, options), *oblique_views(corners, PIXEL_M, options)]
        return [self.render(view) for view in views]

    @cached_property
    def airborne(self) -> AirborneTiles:
        return airborne_tiles(self.renders, PICTURES)

    def walk(self, count: int = 6) -> list[DepthMap]:
        """Photos of two sides of the first box, from 1.6 m above the ground."""
        east, north, *_ = BOXES[0]
        photos = []
        for k, a in enumerate(np.radians(20) + np.linspace(-2.0, 0.2, count)):
            way = np.array([np.cos(a), np.sin(a)])
            centre = np.array([*([east, north] + (14.5 + k % 2) * way), 1.6])
            photos.append(self.photo(f"walk{k}", centre, np.array([east, north, 3.0])))
        return photos


def painted(xyz: NDArray[np.floating]) -> Image:
    """A colour for each half metre of space: no two pictures are alike."""
    cell = np.floor(2 * np.nan_to_num(xyz, nan=-999.0)).astype(np.int64)
    mixed = (cell * [73856093, 19349663, 83492791]).sum(axis=-1)
    return np.stack([(mixed >> shift) % 199 + 30 for shift in (0, 3, 7)], axis=-1).astype(np.uint8)


def floated(maps: Sequence[DepthMap], *, tilt_deg: float = 0.6) -> tuple[list[DepthMap], Similarity]:
    """Maps in a frame of their own, level but for a tilt, a unit near the cameras' height; and the way back."""
    rotation = Rotation.from_euler("z", 130, degrees=True) * Rotation.from_euler("x", tilt_deg, degrees=True)
    level_from_enu = Similarity(1 / 1.72, rotation.as_matrix(), np.array([40.0, -7.0, 3.0]))
    return [transformed_depth_map(depth_map, level_from_enu) for depth_map in maps], level_from_enu.inverse()


@dataclass(frozen=True, eq=False)
class TileOracle:
    """A dense matcher that knows every photo and every tile by its colours.

    `outlier_share` of the matches of a right pair lead to random places and back. A `false_share` of the wrong pairs
    shows a patch of the photo in a patch of the tile, smoothly and with full confidence. With `blind` there is no
    right answer at all. `calls` lists the pairs (photo, tile); `truths` keeps right answers, as they take time.
    """

    airborne: AirborneTiles
    maps_enu: Sequence[DepthMap]
    noise_px: float = 0.3
    outlier_share: float = 0.3
    false_share: float = 0.0
    blind: bool = False
    calls: list[tuple[int, int]] = field(default_factory=list)
    truths: dict[tuple[int, int], Warp] = field(default_factory=dict)

    @cached_property
    def _photos(self) -> dict[bytes, tuple[int, Array32]]:
        photos = [ground_photo(depth_map, PICTURES) for depth_map in self.maps_enu]
        return {photo.raster.rgb.tobytes(): (k, photo.xyz_level) for k, photo in enumerate(photos)}

    @cached_property
    def _tiles(self) -> dict[bytes, tuple[int, Array32]]:
        return {tile.raster.rgb.tobytes(): (k, tile.xyz_enu) for k, tile in enumerate(self.airborne.tiles)}

    def cache_key(self) -> tuple[float, float, float, bool]:
        """For the cache of a run."""
        return self.noise_px, self.outlier_share, self.false_share, self.blind

    def __call__(self, a: Raster, b: Raster) -> Warp:
        (photo, xyz_a), (tile, xyz_b) = self._photos[a.rgb.tobytes()], self._tiles[b.rgb.tobytes()]
        self.calls.append((photo, tile))
        rng = np.random.default_rng([photo, tile])
        if _meet(xyz_a, xyz_b) and not self.blind:
            if (photo, tile) not in self.truths:
                self.truths[photo, tile] = OracleMatcher(xyz_a, xyz_b, noise_px=self.noise_px)(a, b)
            warp = self.truths[photo, tile]
            if np.count_nonzero(warp.confidence_a) > 60:
                return _with_outliers(warp, self.outlier_share, rng)
        shapes = a.mask.shape, b.mask.shape
        return _patch(*shapes, rng) if rng.uniform() < self.false_share else _nothing(*shapes)


def _meet(xyz_a: Array32, xyz_b: Array32) -> bool:
    """A quick look at the boxes around both."""
    if not (np.isfinite(xyz_a).any() and np.isfinite(xyz_b).any()):
        return False
    low = np.maximum(*(np.nanmin(xyz, axis=(0, 1)) for xyz in (xyz_a, xyz_b)))
    high = np.minimum(*(np.nanmax(xyz, axis=(0, 1)) for xyz in (xyz_a, xyz_b)))
    return bool((low <= high).all())


def _nothing(shape_a: tuple[int, ...], shape_b: tuple[int, ...]) -> Warp:
    flows = [np.full((*shape, 2), -1.0, np.float32) for shape in (shape_a, shape_b)]
    return Warp(flows[0], np.zeros(shape_a, np.float32), flows[1], np.zeros(shape_b, np.float32))


def _patch(shape_a: tuple[int, ...], shape_b: tuple[int, ...], rng: np.random.Generator) -> Warp:
    """A square of a that lies on a smaller one of b."""
    warp, size, ratio = _nothing(shape_a, shape_b), int(rng.integers(16, 28)), float(rng.uniform(0.5, 0.9))
    from_a = np.array([rng.uniform(0, side - size) for side in shape_a[::-1]])
    from_b = np.array([rng.uniform(0, side - size) for side in shape_b[::-1]])
    for flow, confidence, (here, there), (extent, by) in (
        (warp.b_from_a, warp.confidence_a, (from_a, from_b), (size, ratio)),
        (warp.a_from_b, warp.confidence_b, (from_b, from_a), (size * ratio, 1 / ratio)),
    ):
        h, w = confidence.shape
        px = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1)
        inside = ((px >= here) & (px < here + extent)).all(axis=-1)
        flow[inside], confidence[inside] = (px[inside] - here) * by + there, 1.0
    return warp


def _with_outliers(warp: Warp, share: float, rng: np.random.Generator) -> Warp:
    """Add matches to anywhere, which lead back, so that they are that share of all."""
    (ha, wa), (hb, wb) = warp.confidence_a.shape, warp.confidence_b.shape
    count = int(share / (1 - share) * np.count_nonzero(warp.confidence_a) / 3)
    a = np.column_stack([rng.integers(0, wa, count), rng.integers(0, ha, count)])
    b = np.column_stack([rng.integers(1, wb - 1, count), rng.integers(1, hb - 1, count)])
    flow_a, flow_b = warp.b_from_a.copy(), warp.a_from_b.copy()
    sure_a, sure_b = warp.confidence_a.copy(), warp.confidence_b.copy()
    flow_a[a[:, 1], a[:, 0]], sure_a[a[:, 1], a[:, 0]] = b + 0.5, 1.0
    for step in np.ndindex(3, 3):
        around = b + np.array(step) - 1
        flow_b[around[:, 1], around[:, 0]], sure_b[around[:, 1], around[:, 0]] = a + 0.5, 1.0
    return Warp(flow_a, sure_a, flow_b, sure_b)


def bent(maps: Sequence[DepthMap], index: int, by_m: float) -> list[DepthMap]:
    """Maps of which one has its camera in a wrong place."""
    out = list(maps)
    pose = out[index].camera.cam_from_world
    moved = Similarity(1.0, pose.rotation, pose.translation + [by_m, 0.0, 0.0])
    out[index] = replace(out[index], camera=replace(out[index].camera, cam_from_world=moved))
    return out
