# SPDX-License-Identifier: Apache-2.0
"""A box on a plane, photographed from known places: everything about it can be written down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics, Similarity
from skymoor.model import NerfBuilder
from skymoor.model.nerf import PriorOptions, Sizes, UncertaintyOptions
from skymoor.types import Camera, Component, DepthMap, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LENS = Intrinsics(96, 72, 84.0, 84.0, 48.0, 36.0)
PIXEL = 1 / 84  # of a photo straight down, on the ground, in level units
ROOF = np.array([0.16, 0.12, 0.1])  # half length, half width, height

TINY = Sizes(
    levels=4,
    base_cells=8,
    table_log2=13,
    finest_table_log2=15,
    finest_px=1.5,
    hidden=16,
    colour_hidden=16,
    geometry=7,
    rays=1024,
    samples=8,
    bins=32,
    iterations=150,
    passes=1000.0,
    table_rate=2e-2,
)
BUILDER = NerfBuilder(
    small=TINY, budget_s=0.0, device="cpu", prior=PriorOptions(cell_px=2.0), uncertainty=UncertaintyOptions(rays=0)
)


def texture(xyz: Array) -> Array:
    """Colours (n, 3) in [0, 1] of points: waves that run up the walls as well."""
    x, y, z = xyz.T
    waves = [np.sin(37 * x + 11 * y + 20 * z), np.sin(53 * y - 17 * x + 31 * z), np.cos(29 * x - 41 * y + 13 * z)]
    return np.asarray(0.5 + 0.3 * np.stack(waves, axis=-1))


def heights(x: Array, y: Array) -> Array:
    """The highest surface at plan positions."""
    return np.where((np.abs(x) < ROOF[0]) & (np.abs(y) < ROOF[1]), ROOF[2], 0.0)


def cast(origin: Array, rays: Array) -> Array:
    """Distance (n,) to the box or the plane, in units of the rays (n, 3)."""
    ground = -origin[2] / rays[:, 2]
    with np.errstate(divide="ignore"):
        sides = np.stack([(np.array([-ROOF[0], -ROOF[1], -1.0]) - origin) / rays, (ROOF - origin) / rays])
    enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
    return np.where((enter < leave) & (enter > 0) & (enter < ground), enter, ground)


def looking(centre: Array, target: Array) -> Camera:
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross(z, [0.3, 0.9, 0.1])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    return Camera("", LENS, Similarity(1.0, rotation, -rotation @ centre))


def cameras() -> list[Camera]:
    """Eight that look down at 50 degrees, and five from above."""
    ring = [np.array([0.8 * np.cos(a), 0.8 * np.sin(a), 0.95]) for a in np.linspace(0, 2 * np.pi, 9)[:-1]]
    above = [np.array([x, y, 1.0]) for x, y in ((0, 0), (-0.2, -0.15), (0.2, -0.15), (-0.2, 0.15), (0.2, 0.15))]
    return [looking(c, np.zeros(3)) for c in ring] + [looking(c, c * [1, 1, 0] + 0.01) for c in above]


def photograph(camera: Camera, rng: np.random.Generator, *, noise_ratio: float, missing: float) -> DepthMap:
    u, v = np.meshgrid(np.arange(LENS.width) + 0.5, np.arange(LENS.height) + 0.5)
    rays = LENS.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation
    z = cast(camera.centre, rays)
    shape = (LENS.height, LENS.width)
    rgb = np.clip(255 * texture(camera.centre + z[:, None] * rays) + 0.5, 0, 255).astype(np.uint8)
    depth = (z * (1 + noise_ratio * rng.standard_normal(len(z)))).reshape(shape).astype(np.float32)
    depth[np.kron(rng.uniform(size=(9, 12)) < missing, np.ones((8, 8), bool))] = np.nan
    sigma = (max(noise_ratio, 1e-3) * z).reshape(shape).astype(np.float32)
    return DepthMap(camera, depth, sigma, np.full(shape, 3, np.uint8), rgb.reshape(*shape, 3))


def photographs(*, noise_ratio: float = 0.0, missing: float = 0.0) -> list[DepthMap]:
    rng = np.random.default_rng(5)
    return [photograph(camera, rng, noise_ratio=noise_ratio, missing=missing) for camera in cameras()]


def component_of(maps: list[DepthMap]) -> Component:
    nothing = np.zeros(0, np.int32)
    return Component(
        tuple(m.camera for m in maps),
        np.zeros((0, 3)),
        np.zeros((0, 3), np.uint8),
        nothing,
        nothing,
        np.zeros((0, 2)),
        0,
    )


def down_view(size: int = 96, half: float = 0.36) -> View:
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    return View(down, -half, -half, 2 * half / size, (size, size))


@dataclass(frozen=True, eq=False)
class Toy:
    """Photos of the box: exact depths, and depths with noise and holes as stereo has them."""

    exact: list[DepthMap]
    rough: list[DepthMap]
    builder: NerfBuilder

    def error_px(self, xyz: NDArray[np.float32], view: View) -> Array:
        """Rendered minus true height (h, w) in pixels; NaN at the box's edges, where a pixel sees both levels."""
        u, v = np.meshgrid(np.arange(view.shape[1]) + 0.5, np.arange(view.shape[0]) + 0.5)
        x, y = view.x0 + u * view.pixel, -(view.y0 + v * view.pixel)
        near = 1.5 * PIXEL
        edge = (np.abs(np.abs(x) - ROOF[0]) < near) & (np.abs(y) < ROOF[1] + near)
        edge |= (np.abs(np.abs(y) - ROOF[1]) < near) & (np.abs(x) < ROOF[0] + near)
        return np.where(edge, np.nan, (xyz[..., 2] - heights(x, y)) / PIXEL)

    def with_sizes(self, **changes: float) -> NerfBuilder:
        """The builder with some sizes of its preset changed."""
        return replace(self.builder, small=replace(self.builder.small, **changes))

    @property
    def untrained(self) -> NerfBuilder:
        """One step at a rate of next to nothing: what is left is the prior."""
        return self.with_sizes(iterations=1, table_rate=1e-12, mlp_rate=1e-12)


def blinded(maps: list[DepthMap]) -> list[DepthMap]:
    """No depth anywhere on the half of the roof, and of its walls, with x > 0."""
    u, v = np.meshgrid(np.arange(LENS.width) + 0.5, np.arange(LENS.height) + 0.5)
    pixels = np.column_stack([u.ravel(), v.ravel()])
    result = []
    for m in maps:
        rays = LENS.rays(pixels) @ m.camera.cam_from_world.rotation
        xyz = m.camera.centre + cast(m.camera.centre, rays)[:, None] * rays
        blind = ((xyz[:, 2] > 0.3 * ROOF[2]) & (xyz[:, 0] > 0)).reshape(m.depth.shape)
        result.append(replace(m, depth=np.where(blind, np.nan, m.depth).astype(np.float32)))
    return result


def blind_half(view: View) -> Mask:
    """Pixels (h, w) of that half, away from its borders."""
    u, v = np.meshgrid(np.arange(view.shape[1]) + 0.5, np.arange(view.shape[0]) + 0.5)
    x, y = view.x0 + u * view.pixel, -(view.y0 + v * view.pixel)
    margin = 2 * PIXEL
    return np.asarray((x > margin) & (x < ROOF[0] - margin) & (np.abs(y) < ROOF[1] - margin))
