# SPDX-License-Identifier: Apache-2.0
"""A small exact world: terrain, houses, trees and cars, ray cast into photos, depths, an orthophoto and a DSM.

Everything is in a local east-north-up frame in metres. Colours come from noise that never repeats, so that each place
looks like no other. One roof is plain on purpose: nothing can be measured on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.raycast import open3d

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

EXTENT_M = 260.0  # of the textured ground; the terrain goes on to twice as much
TEXEL_M = 0.1
GROUND, ROOF, WALL, TREE, CAR, PLAIN = range(6)


@dataclass(frozen=True)
class House:
    """A box of `length` by `width`, its walls `eaves` high over the ground, with a gable of `ridge` on top."""

    east: float
    north: float
    length: float
    width: float
    heading_deg: float
    eaves: float
    ridge: float = 0.0
    plain: bool = False

    def inside(self, east: Array, north: Array, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether plan positions lie under its roof, `margin` metres inside."""
        c, s = np.cos(np.radians(self.heading_deg)), np.sin(np.radians(self.heading_deg))
        x, y = east - self.east, north - self.north
        along, across = c * x + s * y, c * y - s * x
        inside: NDArray[np.bool_] = (np.abs(along) < self.length / 2 - margin) & (
            np.abs(across) < self.width / 2 - margin
        )
        return inside


HOUSES = (
    House(-28, 20, 16, 10, 20, 6.0, 3.0),
    House(2, 26, 14, 9, -12, 5.0, 2.5),
    House(30, 16, 18, 12, 75, 8.5),
    House(-47, 10, 13, 9, 100, 4.5, 2.0),
    House(-4, -2, 15, 12, 5, 6.5, plain=True),
    House(-8, -30, 20, 11, -8, 9.5),
    House(42, -24, 12, 8, 40, 5.5, 2.8),
)
PLAIN_ROOF = HOUSES[4]
PARKING_M = (26.0, 16.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles with a kind and a tint each, the ground's colours, and a sun."""

    vertices: Array32
    triangles: NDArray[np.uint32]
    kind: NDArray[np.int8]
    tint: Array32
    ground: Array32
    detail: Array32
    sun: Array

    @cached_property
    def _caster(self) -> Any:
        o3d = open3d()
        scene = o3d.t.geometry.RaycastingScene(nthreads=2)
        scene.add_triangles(o3d.core.Tensor(self.vertices), o3d.core.Tensor(self.triangles))
        return scene

    def cast(self, origins: Array, directions: Array) -> tuple[Array32, NDArray[np.int64], Array32]:
        """Distance in units of the direction, triangle and its normal, for rays (n, 3)."""
        o3d = open3d()
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=-1).astype(np.float32)
        hits = self._caster.cast_rays(o3d.core.Tensor(rays))
        index = hits["primitive_ids"].numpy().astype(np.int64)
        return hits["t_hit"].numpy(), np.where(index < len(self.kind), index, -1), hits["primitive_normals"].numpy()

    def colours(self, origins: Array, directions: Array) -> Array32:
        """Linear colours (n, 3) in [0, 1] along rays (n, 3), with hard shadows."""
        t, index, normals = self.cast(origins, directions)
        sky = index < 0
        xyz = (origins + np.where(sky, 0, t)[:, None] * directions).astype(np.float32)
        albedo = self._albedo(xyz, index, normals)
        facing = np.sign(-(normals * directions).sum(axis=1))
        slope = np.maximum(facing * (normals @ self.sun.astype(np.float32)), 0)
        o3d = open3d()
        start = xyz + 0.02 * facing[:, None] * normals
        rays = np.concatenate([start, np.broadcast_to(self.sun, start.shape)], axis=-1).astype(np.float32)
        slope *= ~self._caster.test_occlusions(o3d.core.Tensor(rays)).numpy()
        lit = albedo * (0.4 + 0.6 * slope)[:, None]
        lit[sky] = 0.75
        return np.asarray(lit, dtype=np.float32)

    def heights(self, east: Array, north: Array) -> Array:
        """Height of the highest surface at plan positions of any shape."""
        origins = np.stack([east.ravel(), north.ravel(), np.full(east.size, 200.0)], axis=1)
        t, _, _ = self.cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
        return (200.0 - t.astype(np.float64)).reshape(east.shape)

    def colours_from_above(self, east: Array, north: Array) -> Array32:
        """Linear colours (..., 3) seen straight from above."""
        origins = np.stack([east.ravel(), north.ravel(), np.full(east.size, 200.0)], axis=1)
        down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
        return self.colours(origins, down).reshape(*east.shape, 3)

    def _albedo(self, xyz: Array32, index: NDArray[np.int64], normals: Array32) -> Array32:
        x, y, z = xyz.T
        kind = self.kind[index]
        detail = _look_up(self.detail, x, y)
        wall = np.flatnonzero(kind == WALL)
        nx, ny = normals[wall, 0], normals[wall, 1]
        along = x[wall] * -ny + y[wall] * nx + 7.3 * (x[wall] * nx + y[wall] * ny)
        detail[wall] = _look_up(self.detail, along, z[wall] + 40)
        tree = np.flatnonzero(kind == TREE)
        detail[tree] = _look_up(self.detail, 1.3 * x[tree] + z[tree], 1.3 * y[tree] - z[tree])
        detail[(kind == CAR) | (kind == PLAIN)] = 1.0
        albedo = self.tint[index] * detail[:, None]
        ground = np.flatnonzero(kind == GROUND)
        albedo[ground] = _look_up(self.ground, x[ground], y[ground])
        return np.asarray(albedo, dtype=np.float32)


def make_scene(seed: int = 0, *, cars_seed: int = 0, sun_deg: tuple[float, float] = (140.0, 48.0)) -> Scene:
    """The site; other `cars_seed` are other days. `sun_deg` is azimuth from north and elevation."""
    rng, land = np.random.default_rng(seed), Land.of(seed)
    # Another seed is another place: nothing may look the same.
    houses = (*HOUSES, *_random_houses(rng, land, 12)) if seed == 0 else tuple(_random_houses(rng, land, 19))
    ground, detail = _textures(seed)
    parts = [_terrain(land)]
    for house in houses:
        parts += _house(house, land, rng)
    parts += [_tree(e, n, land, rng) for e, n in _free_places(rng, land, houses, 40)]
    parts += _cars(land, np.random.default_rng([seed, cars_seed]))
    counts = np.cumsum([0] + [len(part[0]) for part in parts])
    azimuth, elevation = np.radians(sun_deg)
    sun = np.array(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)], dtype=np.float64
    )
    return Scene(
        vertices=np.concatenate([part[0] for part in parts]).astype(np.float32),
        triangles=np.concatenate([part[1] + n for part, n in zip(parts, counts[:-1], strict=True)]).astype(np.uint32),
        kind=np.concatenate([np.full(len(part[1]), part[2]) for part in parts]).astype(np.int8),
        tint=np.concatenate([np.tile(part[3], (len(part[1]), 1)) for part in parts]).astype(np.float32),
        ground=ground,
        detail=detail,
        sun=sun,
    )


@dataclass(frozen=True)
class Land:
    """Gentle hills, about 1.5 m up and down, a curved road, and where cars are parked."""

    phase: float = 0.6
    road: tuple[float, float, float] = (-14.0, 0.004, 10.0)  # north of its vertex, bend, east of its vertex
    parking: tuple[float, float] = (19.0, -28.0)

    @classmethod
    def of(cls, seed: int) -> Land:
        if seed == 0:
            return cls()
        rng = np.random.default_rng([seed, 2])
        road = rng.uniform(-20, 20), rng.choice([-1, 1]) * rng.uniform(0.002, 0.008), rng.uniform(-60, 60)
        return cls(rng.uniform(0, 6), road, (rng.uniform(-30, 30), road[0] + rng.choice([-16, 16])))

    def height(self, east: Array, north: Array) -> Array:
        """Up of the ground."""
        wave = np.sin(east / 31 + self.phase) * np.cos(north / 27 - self.phase / 2)
        wave = wave + 0.4 * np.sin((east + 2 * north) / 19 + 3 * self.phase)
        return np.asarray(0.012 * east - 0.008 * north + wave)

    def off_road(self, east: Array, north: Array) -> Array:
        """Distance to the road's middle line, measured to the north."""
        middle, bend, vertex = self.road
        return np.asarray(np.abs(north - middle - bend * (east - vertex) ** 2 - 3 * np.sin(east / 23)))


Part = tuple[Array, Array, int, tuple[float, float, float]]


def _terrain(land: Land, step: float = 2.0) -> Part:
    side = np.arange(-EXTENT_M, EXTENT_M + step, step)
    east, north = np.meshgrid(side, side)
    n = len(side)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 1, n + 1], corner[:, None] + [0, n + 1, n]])
    vertices = np.column_stack([east.ravel(), north.ravel(), land.height(east, north).ravel()])
    return vertices, triangles, GROUND, (1.0, 1.0, 1.0)


def _house(house: House, land: Land, rng: np.random.Generator) -> list[Part]:
    c, s = np.cos(np.radians(house.heading_deg)), np.sin(np.radians(house.heading_deg))
    base = float(land.height(np.array(house.east), np.array(house.north)))
    a, b = house.length / 2, house.width / 2
    plan = np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, 0], [a, 0]])
    world = plan @ [[c, s], [-s, c]] + [house.east, house.north]
    eaves, ridge = base + house.eaves, base + house.eaves + house.ridge
    heights = [base - 3] * 4 + [eaves] * 4 + [ridge] * 2
    vertices = np.column_stack([np.concatenate([world[:4], world[:4], world[4:]]), heights])
    walls = [[k, (k + 1) % 4, 4 + (k + 1) % 4] for k in range(4)] + [[k, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
    walls += [[7, 4, 8], [5, 6, 9]]  # gables
    roof = [[4, 5, 9], [4, 9, 8], [6, 7, 8], [6, 8, 9]]
    tint = rng.uniform(0.3, 0.6) * np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.5, 0.95)])
    wall = rng.uniform(0.4, 0.6) * np.array([1.0, 0.95, 0.88])
    kind, colour = (PLAIN, (0.5, 0.49, 0.48)) if house.plain else (ROOF, tuple(tint))
    return [(vertices, np.array(walls), WALL, tuple(wall)), (vertices, np.array(roof), kind, colour)]


def _tree(east: float, north: float, land: Land, rng: np.random.Generator) -> Part:
    """A lumpy ellipsoid on the ground."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 13)[:-1], np.linspace(0.05, np.pi - 0.05, 8))
    radius = rng.uniform(1.5, 3.0) * (1 + 0.12 * rng.normal(size=u.shape))
    z = land.height(np.array(east), np.array(north)) + 3.5 + 1.4 * radius * np.cos(v)
    vertices = np.stack([east + radius * np.sin(v) * np.cos(u), north + radius * np.sin(v) * np.sin(u), z], axis=-1)
    rows, columns = np.meshgrid(np.arange(7), np.arange(12), indexing="ij")
    here, right = (12 * rows + columns).ravel(), (12 * rows + (columns + 1) % 12).ravel()
    triangles = np.concatenate([np.stack([here, right, right + 12], 1), np.stack([here, right + 12, here + 12], 1)])
    return vertices.reshape(-1, 3), triangles, TREE, (0.22, 0.34, 0.16)


def _cars(land: Land, rng: np.random.Generator) -> list[Part]:
    (east, north), (length, width) = land.parking, PARKING_M
    parts = []
    for place in rng.choice(20, 11, replace=False):
        e = east - length / 2 + 2.6 * (place % 10) + 1.5
        n = north + (width / 2 - 3) * (1 if place < 10 else -1)
        z = float(land.height(np.array(e), np.array(n)))
        plan = np.array([[-0.9, -2.1], [0.9, -2.1], [0.9, 2.1], [-0.9, 2.1]]) + [e, n]
        vertices = np.column_stack([np.tile(plan, (2, 1)), [z - 0.3] * 4 + [z + 1.5] * 4])
        sides = [[k, (k + 1) % 4, 4 + (k + 1) % 4] for k in range(4)] + [[k, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
        tint = rng.uniform(0.1, 0.9) * (1 - 0.5 * rng.uniform(size=3) ** 3)
        parts.append((vertices, np.array([*sides, [4, 5, 6], [4, 6, 7]]), CAR, tuple(tint)))
    return parts


def _random_houses(rng: np.random.Generator, land: Land, count: int) -> list[House]:
    """Away from the road, the cars and each other; at seed 0 also from the middle, where `HOUSES` are."""
    houses: list[House] = []
    while len(houses) < count:
        e, n = (float(x) for x in rng.uniform(-100, 100, 2))
        clear = land != Land() or max(abs(e) / 52, abs(n) / 46) > 1
        clear &= land.off_road(np.array(e), np.array(n)) > 14 and not _on_parking(land, e, n, 12)
        if clear and all(np.hypot(e - h.east, n - h.north) > 24 for h in houses):
            size = rng.uniform(9, 18), rng.uniform(8, 12)
            houses.append(House(e, n, *size, rng.uniform(0, 180), rng.uniform(4, 8), rng.choice([0.0, 2.5])))
    return houses


def _on_parking(land: Land, east: float, north: float, margin: float) -> bool:
    x, y = abs(east - land.parking[0]), abs(north - land.parking[1])
    return bool(x < PARKING_M[0] / 2 + margin and y < PARKING_M[1] / 2 + margin)


def _free_places(
    rng: np.random.Generator, land: Land, houses: tuple[House, ...], count: int
) -> list[tuple[float, float]]:
    places: list[tuple[float, float]] = []
    while len(places) < count:
        e, n = rng.uniform(-100, 100, 2)
        on_road = land.off_road(np.array(e), np.array(n)) < 7
        in_house = any(np.hypot(e - h.east, n - h.north) < h.length / 2 + 5 for h in houses)
        if not (_on_parking(land, e, n, 3) or on_road or in_house):
            places.append((float(e), float(n)))
    return places


@cache
def _textures(seed: int) -> tuple[Array32, Array32]:
    """Colours of the ground, and the detail (mean about 1) of everything else; waves of 8 m down to 0.2 m."""
    rng = np.random.default_rng([seed, 1])
    n = round(EXTENT_M / TEXEL_M)
    noise = [_noise(rng, n, wave) for wave in (8.0, 4.0, 2.0, 1.0, 0.5, 0.2)]
    detail = np.exp(sum(amplitude * x for amplitude, x in zip((0.06, 0.08, 0.12, 0.14, 0.14, 0.1), noise, strict=True)))
    axis = ((np.arange(n) + 0.5) * TEXEL_M - EXTENT_M / 2).astype(np.float32)
    east, north = np.meshgrid(axis, axis)
    soil = _noise(rng, n, 12.0)
    share = 1 / (1 + np.exp(-4 * soil))[..., None]
    ground = share * np.float32([0.26, 0.36, 0.16]) + (1 - share) * np.float32([0.42, 0.36, 0.26])
    land = Land.of(seed)
    off_road = land.off_road(east, north)
    ground[off_road < 5.2] = (0.5, 0.5, 0.48)
    ground[off_road < 3.6] = (0.24, 0.24, 0.26)
    ground[(off_road < 0.15) & (np.mod(east, 6) < 3)] = (0.85, 0.85, 0.85)
    x, y = east - land.parking[0], north - land.parking[1]
    lot = (np.abs(x) < PARKING_M[0] / 2) & (np.abs(y) < PARKING_M[1] / 2)
    ground[lot] = (0.32, 0.31, 0.3)
    ground[lot & (np.mod(x + PARKING_M[0] / 2 + 1.1, 2.6) < 0.15) & (np.abs(y) > 3)] = (0.85, 0.85, 0.85)
    return np.asarray(ground * detail[..., None], np.float32), np.asarray(detail, np.float32)


def _noise(rng: np.random.Generator, n: int, wave_m: float) -> Array32:
    """White noise at half the wavelength, interpolated: standard deviation about 1, no wave much shorter."""
    side = int(2 * n * TEXEL_M / wave_m) + 2
    coarse = rng.normal(size=(side, side)).astype(np.float32)
    full = cv2.resize(coarse, (n, n), interpolation=cv2.INTER_CUBIC) if side < n else coarse[:n, :n]
    return np.asarray(full / full.std(), dtype=np.float32)


def _look_up(texture: Array32, x: Array32, y: Array32) -> Array32:
    """Bilinear, mirrored beyond the texture; OpenCV takes no long lists, so they are folded into a picture."""
    n, rows = len(x), -(-len(x) // 1024)
    if not n:
        return np.zeros((0, *texture.shape[2:]), np.float32)
    middle = texture.shape[0] / 2 - 0.5
    u, v = (np.pad(a / TEXEL_M + middle, (0, rows * 1024 - n)).astype(np.float32).reshape(rows, 1024) for a in (x, y))
    values = cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(values.reshape(rows * 1024, *texture.shape[2:])[:n], dtype=np.float32)
