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
        vertices, triangles, feet = [], [], []
        for middle, half, height, heading in zip(self.middle, self.half, self.height, self.heading_deg, strict=True):
            c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
            plan = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.array([[c, s], [-s, c]]) + middle
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


def houses(seed: int) -> Houses:
    """Four boxes; no two seeds share a shape or a window."""
    rng = np.random.default_rng([seed, 1])
    middle = np.array([[-20, -20], [20, -20], [20, 20], [-20, 20]]) + rng.uniform(-3, 3, (4, 2))
    return Houses(middle, rng.uniform(6, 10, (4, 2)), rng.uniform(6, 11, 4), rng.uniform(0, 90, 4), seed)


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


def centres(maps: Sequence[DepthMap]) -> Array:
    """Camera centres (n, 3)."""
    return np.array([depth_map.camera.centre for depth_map in maps])
