# SPDX-License-Identifier: Apache-2.0
"""The terrain: a slope, hills, terraces, and the bed of a pond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.mesh import Label, Part, join, quads, stream
from skymoor.simulate.options import Preset
from skymoor.simulate.place.terraces import Terrace
from skymoor.simulate.plan import Array

FAR_M = 3500.0  # where the world ends, behind the haze
HILLS_M, HILLS_RADIUS_M = 30.0, 85.0  # relief of a hillside within that radius; smaller sites have less, as steep


@dataclass(frozen=True)
class Pond:
    """A shore that wobbles about a circle of `radius_m`; its flat bed lies `depth_m` under the level `up`."""

    radius_m: float
    depth_m: float
    up: float
    phases: tuple[float, float, float]

    def inside(self, east: Array, north: Array) -> Array:
        """Depth share (...,): 0 on dry land, 1 on the flat of the bed."""
        turn = np.arctan2(north, east)
        p, q, r = self.phases
        wobble = 1 + 0.14 * np.sin(2 * turn + p) + 0.08 * np.sin(3 * turn + q) + 0.04 * np.sin(7 * turn + r)
        edge = np.hypot(east, north) / (self.radius_m * wobble)
        t = np.clip((1.08 - edge) / 0.16, 0, 1)
        return np.asarray(t * t * (3 - 2 * t))


@dataclass(frozen=True)
class Land:
    """Height of the ground, metres, for plan positions of any shape."""

    slope: tuple[float, float]
    waves: tuple[tuple[float, float, float, float], ...]  # amplitude, wave numbers east and north, phase
    pond: Pond | None = None
    terraces: tuple[Terrace, ...] = ()

    def height(self, east: ArrayLike, north: ArrayLike) -> Array:
        """Up of the ground or of the pond's bed."""
        e, n = np.asarray(east, np.float64), np.asarray(north, np.float64)
        up = self._dry(e, n)
        if self.pond is not None:
            share = self.pond.inside(e, n)
            up = up * (1 - share) + (self.pond.up - self.pond.depth_m) * share
        return np.asarray(self._terraced(e, n, up) if self.terraces else up)

    def _dry(self, e: Array, n: Array) -> Array:
        up = self.slope[0] * e + self.slope[1] * n
        # Beyond the site the slope levels out, or the horizon would be a ramp.
        up = 25 * np.tanh(up / 25)
        for amplitude, across, along, phase in self.waves:
            up = up + amplitude * np.sin(across * e + along * n + phase)
        return np.asarray(up)

    def _terraced(self, e: Array, n: Array, up: Array) -> Array:
        east, north = (np.broadcast_to(side, up.shape).ravel() for side in (e, n))
        level = up.ravel().copy()
        for terrace in self.terraces:
            terrace.apply(east, north, level)
        return level.reshape(up.shape)

    @property
    def water_up(self) -> float | None:
        """Level of the pond's water."""
        return None if self.pond is None else self.pond.up

    def wet(self, east: float, north: float) -> bool:
        """Whether a place is under water."""
        return self.water_up is not None and bool(self.height(east, north) < self.water_up)


def make_land(preset: Preset, seed: int, radius_m: float) -> Land:
    """The terrain of a site; zero height is about at its middle."""
    rng = stream(seed, "land")
    if preset == "hillside":
        return _hills(rng, radius_m)
    steep = {"office-park": 0.025, "industrial": 0.012, "flooded": 0.003, "old-houses": 0.02}[preset]
    turn = rng.uniform(0, 2 * np.pi)
    flat = 0.25 if preset == "flooded" else 1.0
    waves = []
    for length, amplitude in ((220.0, 1.1), (120.0, 0.6), (60.0, 0.25), (700.0, 4.0)):
        direction = rng.uniform(0, 2 * np.pi)
        k = 2 * np.pi / (length * rng.uniform(0.8, 1.2))
        near = amplitude * flat if length < 500 else amplitude * 0.5
        waves.append((near, float(k * np.cos(direction)), float(k * np.sin(direction)), float(rng.uniform(0, 6.3))))
    slope = (float(steep * np.cos(turn)), float(steep * np.sin(turn)))
    dry = Land(slope, tuple((a, b, c, d) for a, b, c, d in waves))
    if preset != "flooded":
        return dry
    # A little under the lowest of the shore, so that the water ends where the land rises.
    around = np.linspace(0, 2 * np.pi, 73)
    radius, rim = 0.5 * radius_m, 0.6 * radius_m
    low = float(dry.height(rim * np.cos(around), rim * np.sin(around)).min())
    p, q, r = (float(x) for x in rng.uniform(0, 6.3, 3))
    return replace(dry, pond=Pond(radius, 1.7, low - 0.3, (p, q, r)))


def _hills(rng: np.random.Generator, radius_m: float) -> Land:
    """Two long waves that cross, the site on the flanks of both, and bumps.

    Relief of 30 m within 85 m, and in proportion within a smaller radius: what is as steep is as hilly.
    """
    reach = min(radius_m, HILLS_RADIUS_M)
    turn = rng.uniform(0, 2 * np.pi)
    waves = []
    for across in (0.0, np.pi / 2):
        k = 2 * np.pi / (reach * rng.uniform(4.2, 5.2))
        phase = float(rng.choice([0.0, np.pi]) + rng.uniform(-0.4, 0.4))
        waves.append((1.0, float(k * np.cos(turn + across)), float(k * np.sin(turn + across)), phase))
    side = np.linspace(-reach, reach, 61)
    east, north = (x[np.hypot(*np.meshgrid(side, side)) <= reach] for x in np.meshgrid(side, side))
    amplitude = HILLS_M * reach / HILLS_RADIUS_M / float(np.ptp(Land((0.0, 0.0), tuple(waves)).height(east, north)))
    waves = [(amplitude, *wave[1:]) for wave in waves]
    for length, bump in ((120.0, 0.3), (60.0, 0.12)):
        direction, k = rng.uniform(0, 2 * np.pi), 2 * np.pi / (length * rng.uniform(0.8, 1.2))
        waves.append((bump, float(k * np.cos(direction)), float(k * np.sin(direction)), float(rng.uniform(0, 6.3))))
    return Land((0.0, 0.0), tuple(waves))


def terrain(land: Land, radius_m: float, extent_m: float, near_page: int, far_page: int) -> Part:
    """The ground as a mesh: fine within `radius_m` (page `near_page`), coarser to the horizon (`far_page`).

    Both pages are centred on the origin, `near_page` reaching to `radius_m` and `far_page` to `extent_m`.
    """
    near = _lattice(np.linspace(-radius_m, radius_m, int(radius_m / 0.75) * 2 + 1), land.height, radius_m, near_page)
    # The rings share no vertices with what is inside of them: one ray in some hundred thousand slips through.
    outer = _ring(land, extent_m, radius_m, 4.0, extent_m, far_page)
    far = _ring(land, FAR_M, extent_m, 60.0, extent_m, far_page)
    return join([near, outer, far])


def water(land: Land) -> Part:
    """The surface of the pond; empty without one."""
    up = land.water_up
    if up is None or land.pond is None:
        return join([])
    side = np.linspace(-1.4, 1.4, 41) * land.pond.radius_m
    return _lattice(
        side, lambda e, n: np.full(np.shape(e), up), side[-1], 0, label=Label.WATER, tint=(0.03, 0.045, 0.035)
    )


def _ring(land: Land, outer_m: float, inner_m: float, step_m: float, page_half_m: float, page: int) -> Part:
    """A square ring; its inner edge lies on the outer edge of what it surrounds."""
    count = max(int(np.ceil((outer_m - inner_m) / step_m)), 1)
    arm = np.linspace(inner_m, outer_m, count + 1)
    middle = np.linspace(-inner_m, inner_m, max(int(2 * inner_m / min(step_m, 12.0)), 1) + 1)
    side = np.concatenate([-arm[:0:-1], middle, arm[1:]])
    part = _lattice(side, land.height, page_half_m, page)
    centre = part.corners.mean(axis=1)
    keep = np.max(np.abs(centre[:, :2]), axis=1) > inner_m
    return Part(*(getattr(part, name)[keep] for name in ("corners", "uv", "page", "label", "tint")))


def _lattice(
    side: Array,
    height: Callable[[Array, Array], Array],
    page_half_m: float,
    page: int,
    *,
    label: Label = Label.GROUND,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Part:
    east, north = np.meshgrid(side, side)
    points = np.stack([east, north, height(east, north)], axis=-1)
    uv = np.stack([east + page_half_m, page_half_m - north], axis=-1)
    squares = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))]
    squares += [(slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]
    corners = np.stack([points[square] for square in squares], axis=2).reshape(-1, 4, 3)
    return quads(corners, np.stack([uv[square] for square in squares], axis=2).reshape(-1, 4, 2), page, label, tint)
