# SPDX-License-Identifier: Apache-2.0
"""The cars of a day."""

from __future__ import annotations

import numpy as np

from skymoor.simulate.light.pages import WHITE
from skymoor.simulate.mesh import Label, Part, join, parallelograms, quads, stream
from skymoor.simulate.place.layout import Plan
from skymoor.simulate.place.occupied import placed
from skymoor.simulate.plan import Array, Strip, Yard

PAINTS = ((0.62, 0.62, 0.61), (0.02, 0.02, 0.022), (0.12, 0.125, 0.13), (0.36, 0.37, 0.38), (0.05, 0.09, 0.2),
          (0.30, 0.035, 0.03), (0.10, 0.13, 0.10), (0.33, 0.28, 0.2), (0.05, 0.16, 0.24))  # fmt: skip
PAINT_SHARES = np.array([26, 20, 19, 15, 8, 6, 2, 2, 2]) / 100
TYRE, DARK_GLASS = (0.02, 0.02, 0.02), (0.012, 0.014, 0.015)
FULL_SHARE = 0.55  # of the bays of a car park
PARKED_SHARE = 0.8  # of the places before facades


def cars(plan: Plan, seed: int, day: str) -> Part:
    """The cars of one day, in the bays of car parks, on the roads and parked before facades."""
    rng = stream(seed, "cars", day)
    places = [place for yard in plan.yards if yard.kind == "parking" for place in _bays(yard)]
    places = [place for place in places if rng.uniform() < FULL_SHARE]
    places += [place for yard in plan.yards if yard.kind == "concrete" for place in _strewn(yard, rng)]
    places += [place for strip in plan.strips if strip.kind == "road" for place in _driving(strip, plan.extent_m, rng)]
    places += _parked(plan.parked, stream(seed, "parked", day))
    parts = []
    for east, north, heading in places:
        if plan.land.wet(east, north):
            continue
        body = _van(rng) if rng.uniform() < 0.15 else _car(rng)
        turned = heading + rng.choice([0, 180]) + rng.normal(scale=2)
        parts.append(body.placed(turned, [east, north, float(plan.land.height(east, north)) - 0.03]))
    return join(parts)


def _bays(yard: Yard) -> list[tuple[float, float, float]]:
    xs = np.arange(-yard.length_m / 2 + 1.3, yard.length_m / 2 - 1.0, 2.6)
    sides = (-1, 1) if yard.width_m > 15 else (-1,)
    inner = np.array([(x, side * (yard.width_m / 2 - 2.5)) for x in xs for side in sides]).reshape(-1, 2)
    return [(e, n, yard.heading_deg + 90) for e, n in placed(inner, yard.east, yard.north, yard.heading_deg)]


def _parked(
    places: tuple[tuple[float, float, float], ...], rng: np.random.Generator
) -> list[tuple[float, float, float]]:
    """Those that are taken today, no car quite where another one stood."""
    taken = []
    for east, north, heading in places:
        here, shift = rng.uniform() < PARKED_SHARE, float(rng.normal(scale=0.3))
        if here:
            c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
            taken.append((float(east + shift * c), float(north + shift * s), heading))
    return taken


def _strewn(yard: Yard, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    count = int(rng.integers(0, 3))
    inner = rng.uniform(-0.4, 0.4, (count, 2)) * [yard.length_m, yard.width_m]
    plan = placed(inner, yard.east, yard.north, yard.heading_deg)
    return [(e, n, yard.heading_deg + rng.choice([0, 90])) for e, n in plan]


def _driving(strip: Strip, extent_m: float, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    line = np.array(strip.line)
    places = []
    for _ in range(rng.poisson(len(line) / 7)):
        k = int(rng.integers(len(line) - 1))
        step = line[k + 1] - line[k]
        side = np.array([step[1], -step[0]]) / np.linalg.norm(step)
        e, n = line[k] + rng.uniform() * step + rng.choice([-1, 1]) * 0.25 * strip.width_m * side
        if max(abs(e), abs(n)) < extent_m:
            places.append((float(e), float(n), float(np.degrees(np.arctan2(step[1], step[0])))))
    return places


def _car(rng: np.random.Generator) -> Part:
    """About 4.3 m, along x: a body, a tapering cabin of glass, wheels, lamps."""
    paint = np.array(PAINTS[rng.choice(len(PAINTS), p=PAINT_SHARES)]) * rng.uniform(0.85, 1.15)
    length, width, belt, roof = (
        rng.uniform(3.9, 4.7),
        rng.uniform(1.7, 1.85),
        rng.uniform(0.8, 0.92),
        rng.uniform(1.4, 1.6),
    )
    hatch = rng.uniform() < 0.5
    body = _prism((-length / 2, length / 2), width, 0.25, (-length / 2 + 0.05, length / 2 - 0.12), width * 0.96, belt)
    back = -length / 2 + (0.15 if hatch else 0.75)
    cabin = _prism((back, 0.22 * length), width * 0.93, belt, (back + 0.35, 0.02 * length), width * 0.78, roof)
    parts = [
        quads(body, _flat_uv(body), WHITE, Label.CAR, paint),
        quads(cabin[1:], _flat_uv(cabin[1:]), WHITE, Label.GLASS, DARK_GLASS),
        quads(cabin[:1], _flat_uv(cabin[:1]), WHITE, Label.CAR, paint),
    ]
    for x, tint in ((length / 2 + 0.005, (0.6, 0.6, 0.55)), (-length / 2 - 0.005, (0.25, 0.02, 0.02))):
        corners = [[x, y, 0.6] for y in (-0.38 * width, 0.22 * width)]
        parts.append(parallelograms(corners, [0, 0.16 * width, 0], [0, 0, 0.14], WHITE, Label.CAR, tint))
    return join([*parts, *_wheels(length, width)])


def _van(rng: np.random.Generator) -> Part:
    paint = np.array(PAINTS[rng.choice([0, 0, 0, 2, 3, 4, 7])]) * rng.uniform(0.85, 1.1)
    body = _prism((-2.6, 2.6), 1.95, 0.3, (-2.55, 1.6), 1.85, 2.35)
    glass = _prism((1.55, 2.28), 1.97, 1.2, (1.45, 1.9), 1.9, 1.95)
    parts = [quads(body, _flat_uv(body), WHITE, Label.CAR, paint)]
    parts.append(quads(glass, _flat_uv(glass), WHITE, Label.GLASS, DARK_GLASS))
    return join([*parts, *_wheels(5.2, 1.95)])


def _wheels(length: float, width: float) -> list[Part]:
    turn = np.linspace(0, 2 * np.pi, 11)
    ring = 0.31 * np.column_stack([np.cos(turn), np.sin(turn)])
    parts = []
    for x in (-0.3 * length, 0.31 * length):
        for y in (-width / 2 - 0.01, width / 2 + 0.01):
            outer = np.column_stack([ring[:, 0] + x, np.full(11, y), ring[:, 1] + 0.31])
            middle = np.broadcast_to([x, y, 0.31], (10, 3))
            fan = np.stack([middle, outer[:-1], outer[1:], middle], axis=1)
            parts.append(quads(fan, _flat_uv(fan), WHITE, Label.CAR, TYRE))
    return parts


def _prism(
    low_x: tuple[float, float], low_w: float, low_z: float, high_x: tuple[float, float], high_w: float, high_z: float
) -> Array:
    """Faces (5, 4, 3), the top first, of a block that tapers upwards."""
    low = np.array([[x, y, low_z] for x, y in _box(low_x, low_w)])
    high = np.array([[x, y, high_z] for x, y in _box(high_x, high_w)])
    sides = [[low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]] for k in range(4)]
    return np.array([high, *sides])


def _box(x: tuple[float, float], width: float) -> list[tuple[float, float]]:
    return [(x[0], -width / 2), (x[1], -width / 2), (x[1], width / 2), (x[0], width / 2)]


def _flat_uv(corners: Array) -> Array:
    return np.zeros((*corners.shape[:-1], 2))
