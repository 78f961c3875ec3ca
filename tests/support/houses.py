# SPDX-License-Identifier: Apache-2.0
"""Boxes with windows on flat ground, photographed from the air and from the ground with exact depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.engines.raycast import RayCaster
from skymoor.geometry import Intrinsics
from skymoor.types import Camera, DepthMap
from support.blocks import look_at

Array = NDArray[np.float64]

TEXEL_M = 0.1
WALL_TEXELS = (120, 300)


@dataclass(frozen=True, eq=False)
class Houses:
    """Boxes: middle (n, 2), half sizes (n, 2), heights (n,) in metres, headings (n,) in degrees; windows by `seed`."""

    middle: Array
    half: Array
    height: Array
    heading_deg: Array
    seed: int

    @cached_property
    def _scene(self) -> tuple[RayCaster, NDArray[np.uint8], list[Array]]:
        vertices: list[Array] = []
        triangles: list[list[int]] = []
        feet: list[Array] = []
        for middle, half, height, heading in zip(self.middle, self.half, self.height, self.heading_deg, strict=True):
            plan = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ turned(heading) + middle
            first = sum(map(len, vertices))
            vertices.append(np.vstack([np.column_stack([plan, np.full(4, z)]) for z in (0.0, height)]))
            for k in range(4):  # each wall two triangles, then the roof
                a, b = first + k, first + (k + 1) % 4
                triangles += [[a, b, b + 4], [a, b + 4, a + 4]]
                feet.append(plan[k])
            triangles += [[first + 4, first + 5, first + 6], [first + 4, first + 6, first + 7]]
        first = sum(map(len, vertices))
        vertices.append(np.array([[-150, -150, 0], [150, -150, 0], [150, 150, 0], [-150, 150, 0]], dtype=np.float64))
        triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
        walls = np.stack([self._wall(k) for k in range(len(feet))])
        caster = RayCaster(np.concatenate(vertices).astype(np.float32), np.array(triangles, np.uint32), threads=1)
        return caster, walls, feet

    def _wall(self, k: int) -> NDArray[np.uint8]:
        """Grey values of a wall, first row at the ground: windows of some sizes at irregular places."""
        rng = np.random.default_rng([self.seed, k])
        wall = np.full(WALL_TEXELS, rng.integers(120, 200), np.uint8)
        for row in range(8, WALL_TEXELS[0], 30):
            column = 5
            while column < WALL_TEXELS[1] - 20:
                width, height = int(rng.integers(8, 22)), int(rng.integers(10, 18))
                if rng.random() < 0.7:
                    wall[row : row + height, column : column + width] = rng.integers(20, 70)
                column += width + int(rng.integers(6, 24))
        return wall

    def tops(self, plan: Array) -> Array:
        """Heights (...,) of the uppermost surface at plan positions (..., 2): roofs, and the ground at 0."""
        up = np.zeros(plan.shape[:-1])
        for middle, half, height, heading in zip(self.middle, self.half, self.height, self.heading_deg, strict=True):
            own = (plan - middle) @ turned(heading).T
            up = np.where((np.abs(own) <= half).all(axis=-1), np.maximum(up, height), up)
        return up

    def photo(self, name: str, centre: Array, target: Array, lens: Intrinsics) -> DepthMap:
        """What a camera at `centre` sees that looks at `target`."""
        caster, walls, feet = self._scene
        camera = Camera(name, lens, look_at(centre, target))
        u, v = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
        rays = lens.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation
        z, triangle, _, _ = caster.hits(centre.astype(np.float32), rays.astype(np.float32))
        seen = np.isfinite(z)
        xyz = centre + np.where(seen, z, 0)[:, None] * rays
        part = triangle // 2
        wall = np.where(seen & (part % 5 < 4) & (part < 5 * len(self.middle)), part // 5 * 4 + part % 5, -1)
        noise = np.random.default_rng([self.seed, 999]).integers(90, 130, (60, 60), dtype=np.uint8)
        cell = np.floor(xyz[:, :2] / 2.0).astype(int) % 60
        grey = np.where(seen, noise[cell[:, 0], cell[:, 1]], 235)
        on = wall >= 0
        s = np.linalg.norm(xyz[on, :2] - np.array(feet)[wall[on]], axis=1)
        column = np.clip(s / TEXEL_M, 0, WALL_TEXELS[1] - 1).astype(int)
        row = np.clip(xyz[on, 2] / TEXEL_M, 0, WALL_TEXELS[0] - 1).astype(int)
        grey[on] = walls[wall[on], row, column]
        rgb = cv2.cvtColor(grey.reshape(u.shape).astype(np.uint8), cv2.COLOR_GRAY2RGB)
        depth = np.where(seen, z, np.nan).reshape(u.shape).astype(np.float32)
        return DepthMap(camera, depth, 0.005 * depth, np.full(u.shape, 3, np.uint8), rgb)


def turned(heading_deg: float) -> Array:
    """What turns row vectors (n, 2) counter-clockwise: points @ turned(30.0)."""
    c, s = np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))
    return np.array([[c, s], [-s, c]])


def houses(seed: int) -> Houses:
    """Four boxes; no two seeds share a shape or a window."""
    rng = np.random.default_rng([seed, 1])
    middle = np.array([[-20, -20], [20, -20], [20, 20], [-20, 20]]) + rng.uniform(-3, 3, (4, 2))
    return Houses(middle, rng.uniform(6, 10, (4, 2)), rng.uniform(6, 11, 4), rng.uniform(0, 90, 4), seed)


def site_with_an_l() -> Houses:
    """A house of two wings, the first two boxes, whose inner corner is open to the north-east; three boxes around."""
    heading = 20.0
    long_wing = np.array([-14.0, -12.0])
    middle = np.array([long_wing, long_wing + [-6.0, 8.0] @ turned(heading), [22, 16], [-22, 24], [20, -24]])
    half = np.array([[10.0, 4.0], [4.0, 8.0], [7.0, 5.0], [6.0, 8.0], [9.0, 6.0]])
    return Houses(middle, half, np.array([6.5, 6.5, 8, 7, 7.5]), np.array([heading, heading, 50, 10, 75]), seed=3)


def from_the_air(world: Houses) -> list[DepthMap]:
    """Ten oblique photos from 50 m, 0.15 m a pixel."""
    lens = Intrinsics(400, 300, 480.0, 480.0, 200.0, 150.0)
    ways = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    return [
        world.photo(f"air{k}", np.array([50 * np.sin(a), 50 * np.cos(a), 50.0]), np.zeros(3), lens)
        for k, a in enumerate(ways)
    ]


def walk_round(world: Houses, house: int, count: int = 8) -> list[DepthMap]:
    """Photos of two sides of a box, from 1.6 m above the ground and 14 m from its middle or a bit more."""
    lens = Intrinsics(320, 240, 240.0, 240.0, 160.0, 120.0)
    middle = world.middle[house]
    start = np.radians(world.heading_deg[house]) - np.pi / 2
    photos = []
    for k, a in enumerate(start + np.linspace(-0.3, 1.8, count)):
        centre = np.array([*(middle + (15 + k % 3) * np.array([np.cos(a), np.sin(a)])), 1.6])
        photos.append(world.photo(f"walk{k}", centre, np.array([*middle, 3.5]), lens))
    return photos


def walk_round_the_l(world: Houses, count: int = 12) -> list[DepthMap]:
    """Photos of all sides of the house of `site_with_an_l`, from 1.75 m above the ground."""
    lens = Intrinsics(320, 240, 240.0, 240.0, 160.0, 120.0)
    middle = world.middle[0] + [-3.0, 4.0] @ turned(world.heading_deg[0])
    photos = []
    for k, a in enumerate(np.radians(world.heading_deg[0]) + np.linspace(-3.0, 3.0, count)):
        centre = np.array([*(middle + (16 + k % 3) * np.array([np.cos(a), np.sin(a)])), 1.75])
        photos.append(world.photo(f"walk{k}", centre, np.array([*middle, 3.5]), lens))
    return photos


def nearly_straight_down(
    world: Houses, target: Array, azimuth_deg: float, nadir_deg: Sequence[float], *, focal_px: float = 900.0
) -> list[DepthMap]:
    """Photos of `target` (3,) from 55 m, from this side of it and under these angles from the vertical."""
    lens = Intrinsics(480, 360, focal_px, focal_px, 240.0, 180.0)
    side, up_m = np.array([np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))]), 55.0 - target[2]
    photos = []
    for k, angle in enumerate(np.radians(nadir_deg)):
        centre = target + [*(up_m * np.tan(angle) * side), up_m]
        photos.append(world.photo(f"down{azimuth_deg:.0f}_{k}", centre, target, lens))
    return photos


def centres(maps: Sequence[DepthMap]) -> Array:
    """Camera centres (n, 3)."""
    return np.array([depth_map.camera.centre for depth_map in maps])
