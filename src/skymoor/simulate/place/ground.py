# SPDX-License-Identifier: Apache-2.0
"""The ground painted: grass and soil, roads with their markings and repairs, car parks, yards."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.simulate.mesh import rectangle, stream
from skymoor.simulate.place.layout import Plan
from skymoor.simulate.place.noise import field
from skymoor.simulate.place.occupied import grown, placed
from skymoor.simulate.plan import Array, Season, Strip, Yard

Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

GRASS: dict[Season, tuple[float, float, float]] = {
    "summer": (0.105, 0.150, 0.045),
    "autumn": (0.170, 0.155, 0.065),
    "winter": (0.165, 0.145, 0.090),
}
SOIL = (0.23, 0.17, 0.11)
GRAVEL = (0.27, 0.25, 0.22)
MUD = (0.13, 0.11, 0.08)
ASPHALT, OLD_ASPHALT, CONCRETE, PAINT = (
    (0.085, 0.085, 0.09),
    (0.15, 0.148, 0.145),
    (0.36, 0.345, 0.32),
    (0.62, 0.61, 0.58),
)
SUB = 4  # bits of sub-pixel precision in OpenCV's drawing


@dataclass(frozen=True)
class Canvas:
    """A square picture of the plan, `half_m` each way, north up."""

    half_m: float
    size: int

    @property
    def texel_m(self) -> float:
        """Size of a texel."""
        return 2 * self.half_m / self.size

    def px(self, shapes: Iterable[ArrayLike]) -> list[NDArray[np.int32]]:
        """Shapes of plan positions (k, 2) in OpenCV's fixed-point pixels."""
        plans = [np.asarray(shape, np.float64).reshape(-1, 2) for shape in shapes]
        if not plans:
            return []
        # All at once: there are thousands of small ones.
        e, n = np.concatenate(plans).T
        uv = np.stack([(e + self.half_m) / self.texel_m - 0.5, (self.half_m - n) / self.texel_m - 0.5], axis=1)
        fixed = np.asarray(np.clip(uv, -20000, 40000) * (1 << SUB), dtype=np.int32)
        ends = np.cumsum([len(plan) for plan in plans]).tolist()
        return [fixed[first:last] for first, last in zip([0, *ends], ends, strict=False)]

    def lines(self, lines: Iterable[ArrayLike], width_m: float) -> Array32:
        """Coverage (size, size) in [0, 1] of polylines (k, 2)."""
        mask = np.zeros((self.size, self.size), np.uint8)
        width = width_m / self.texel_m
        thickness = max(round(width), 1)
        cv2.polylines(
            mask, self.px(lines), isClosed=False, color=255, thickness=thickness, lineType=cv2.LINE_AA, shift=SUB
        )
        return mask * np.float32(min(width, 1.0) / 255)

    def areas(self, outlines: Iterable[ArrayLike]) -> Array32:
        """Coverage (size, size) in [0, 1] of polygons (k, 2)."""
        mask = np.zeros((self.size, self.size), np.uint8)
        for outline in self.px(outlines):  # one by one: together, what two of them cover would be left out
            cv2.fillPoly(mask, [outline], 255, cv2.LINE_AA, SUB)
        return mask * np.float32(1 / 255)


def paint_ground(plan: Plan, seed: int, season: Season, half_m: float, texel_m: float) -> Array32:
    """Albedo (n, n, 3) of the ground within `half_m` of the origin, north up.

    The same places look the same at every resolution and, but for the plants, in every season.
    """
    canvas = Canvas(half_m, round(2 * half_m / texel_m))
    noise = _Noise(seed, canvas, plan.extent_m)
    colour = _meadow(noise, season, plan.barren)
    stone = noise.sum_of("stone", ((17.0, 0.8), (5.0, 0.8), (1.6, 0.6), (0.5, 0.6), (0.16, 0.7)))
    if plan.land.pond is not None:
        _lay(colour, _bed(canvas, plan), MUD, stone, 0.15)
    roads = [strip for strip in plan.strips if strip.kind == "road"]
    paths = [strip for strip in plan.strips if strip.kind == "path"]
    for strips, margin, base in ((paths, 0.0, CONCRETE), (roads, 3.2, CONCRETE), (roads, 0.0, OLD_ASPHALT)):
        for strip in strips:
            _lay(colour, canvas.lines([strip.line], strip.width_m + margin), base, stone, 0.12)
    aprons = [
        placed(grown(b.outline, 1.6), b.east, b.north, b.heading_deg) for b in (*plan.buildings, *plan.distractors)
    ]
    _lay(colour, canvas.areas(aprons), CONCRETE, stone, 0.10)
    for kind, base in (("parking", ASPHALT), ("concrete", CONCRETE)):
        _lay(colour, canvas.areas([_outline(y) for y in plan.yards if y.kind == kind]), base, stone, 0.12)
    _wear(colour, canvas, plan, seed)
    _mark(colour, canvas, roads, plan.yards, noise)
    return np.clip(colour, 0.01, 0.9, out=colour)


class _Noise:
    """Fields on one canvas; those finer than its texels are nothing."""

    def __init__(self, seed: int, canvas: Canvas, extent_m: float) -> None:
        self._seed, self._canvas, self._extent = seed, canvas, extent_m

    def of(self, name: str, wave_m: float) -> Array32:
        c = self._canvas
        if wave_m < 2 * c.texel_m:
            return np.zeros((1, 1), np.float32)
        # Fine fields only exist near the middle: nobody sees them elsewhere.
        extent = self._extent if wave_m > 1.5 else min(self._extent, c.half_m)
        return field(self._seed, name, wave_m, c.half_m, c.size, extent_m=extent)

    def sum_of(self, name: str, waves: Sequence[tuple[float, float]]) -> Array32:
        """Fields of several wavelengths, each with its weight."""
        total = np.zeros((self._canvas.size, self._canvas.size), np.float32)
        for wave_m, weight in waves:
            total += np.float32(weight) * self.of(name, wave_m)
        return total


def _meadow(noise: _Noise, season: Season, barren: float) -> Array32:
    """Grass with bare and lush patches, mown unevenly; gravel and soil where the site is `barren`."""
    mid = noise.of("grass", 9.0)
    fine = noise.sum_of("grass", ((2.5, 0.5), (0.8, 0.6), (0.3, 0.6)))
    dry = 1 / (1 + np.exp(-(1.2 * noise.of("grass", 26.0) + 0.9 * mid + 0.4 * fine)))
    grass = np.array(GRASS[season], np.float32)
    straw = np.array((0.20, 0.18, 0.12) if season == "winter" else (0.24, 0.21, 0.10), np.float32)
    colour = grass + (0.55 * dry)[..., None] * (straw - grass)
    bare = np.clip(1.6 * (noise.sum_of("soil", ((11.0, 0.8), (3.0, 0.5))) + 0.3 * fine) - 2.1 + 2.9 * barren, 0, 1)
    soil = np.array(SOIL, np.float32) * (1 - barren) + np.array(GRAVEL, np.float32) * barren
    colour += bare[..., None] * (soil - colour)
    colour *= np.exp(0.14 * fine + 0.12 * noise.of("grass", 0.14) + 0.07 * mid)[..., None]
    return np.asarray(colour, np.float32)


def _bed(canvas: Canvas, plan: Plan) -> Array32:
    """Where the pond is (size, size)."""
    pond = plan.land.pond
    if pond is None:
        return np.zeros((canvas.size, canvas.size), np.float32)
    side = ((np.arange(256) + 0.5) / 128 - 1) * canvas.half_m
    east, north = np.meshgrid(side, -side)
    shore = np.clip(3 * pond.inside(east, north), 0, 1).astype(np.float32)
    return np.asarray(cv2.resize(shore, (canvas.size, canvas.size)))


def _lay(colour: Array32, cover: Array32, base: tuple[float, float, float], tone: Array32, strength: float) -> None:
    """Blend a stony material into `colour` where `cover` (h, w) is, in place and only there."""
    index = np.flatnonzero(cover)
    share = cover.reshape(-1, 1)[index]
    tones = tone.ravel()[index] if tone.size == cover.size else np.broadcast_to(tone.ravel()[:1], len(index))
    over = np.exp(strength * tones)[:, None] * np.array(base, np.float32)
    flat = colour.reshape(-1, 3)
    flat[index] += share * (over - flat[index])


def _wear(colour: Array32, canvas: Canvas, plan: Plan, seed: int) -> None:
    """Repairs, cracks, manholes and oil on everything that is paved."""
    rng = stream(seed, "wear")
    places = _paved_places(plan, rng)
    patches: dict[float, list[Array]] = {0.55: [], 0.8: [], 1.35: []}
    cracks: list[Array] = []
    spots: list[tuple[Array, float]] = []
    for place in places:
        shade = float(rng.choice(list(patches)))
        size = rng.uniform(0.6, 4.5, 2) * (1, 0.5)
        patches[shade].append(placed(rectangle(*size), place[0], place[1], rng.uniform(0, 180)))
        if rng.uniform() < 0.75:
            steps = rng.normal(scale=0.35, size=(18, 2)) + rng.normal(scale=0.35, size=2)
            cracks.append(place + rng.uniform(-3, 3, 2) + np.cumsum(steps, axis=0))
        spots.append((place + rng.uniform(-4, 4, 2), float(rng.uniform(0.12, 0.5))))
    turn = np.linspace(0, 2 * np.pi, 14)
    discs = [middle + radius * np.column_stack([np.cos(turn), np.sin(turn)]) for middle, radius in spots]
    factor = np.ones((canvas.size, canvas.size), np.float32)
    for shade, outlines in patches.items():
        factor *= 1 + np.float32(shade - 1) * canvas.areas(outlines)
    factor *= (1 - 0.55 * canvas.lines(cracks, 0.03)) * (1 - 0.5 * canvas.areas(discs))
    colour *= (1 + _paved(canvas, plan) * (factor - 1))[..., None]


def _paved_places(plan: Plan, rng: np.random.Generator) -> Array:
    """Random places (n, 2) on roads and yards."""
    places = [
        np.array(s.line)[:-1] + rng.uniform(0, 1, (len(s.line) - 1, 1)) * np.diff(np.array(s.line), axis=0)
        for s in plan.strips
        for _ in range(3)
    ]
    places = [p + rng.uniform(-3, 3, p.shape) for p in places]
    for yard in plan.yards:
        count = int(yard.length_m * yard.width_m / 14)
        inner = rng.uniform(-0.5, 0.5, (count, 2)) * [yard.length_m, yard.width_m]
        places.append(placed(inner, yard.east, yard.north, yard.heading_deg))
    return np.concatenate(places) if places else np.zeros((0, 2))


def _paved(canvas: Canvas, plan: Plan) -> Array32:
    cover = canvas.areas([_outline(yard) for yard in plan.yards])
    for strip in plan.strips:
        cover = np.maximum(cover, canvas.lines([strip.line], strip.width_m))
    return cover


def _mark(colour: Array32, canvas: Canvas, roads: Sequence[Strip], yards: Sequence[Yard], noise: _Noise) -> None:
    """White paint: dashes and edge lines of roads, bays of car parks, joints of concrete yards."""
    worn = np.clip(0.75 + noise.sum_of("paint", ((3.0, 0.25), (0.4, 0.25))), 0.15, 1)
    cover = np.zeros_like(worn)
    for road in roads:
        line = np.array(road.line)
        fine = np.stack(
            [np.interp(np.arange(0, len(line) - 1, 0.1), np.arange(len(line)), line[:, k]) for k in (0, 1)], axis=1
        )
        normal = np.gradient(fine, axis=0)[:, ::-1] * [-1, 1]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        edges = [fine + side * (road.width_m / 2 - 0.3) * normal for side in (-1, 1)]
        dashes = canvas.lines([fine[k : k + 4] for k in range(0, len(fine), 8)], 0.13)
        cover = np.maximum(cover, np.maximum(dashes, 0.8 * canvas.lines(edges, 0.1)))
    # Nothing is painted where roads cross.
    count = sum((canvas.lines([road.line], road.width_m) for road in roads), start=np.zeros_like(worn))
    cover[count > 1.5] = 0
    bays = [bay for yard in yards if yard.kind == "parking" for bay in _bay_lines(yard)]
    cover = np.maximum(cover, canvas.lines(bays, 0.1)) * worn
    _lay(colour, cover, PAINT, np.zeros((1, 1), np.float32), 0.0)
    joints = [joint for yard in yards if yard.kind == "concrete" for joint in _joints(yard)]
    colour *= 1 - 0.45 * canvas.lines(joints, 0.04)[..., None]


def _bay_lines(yard: Yard) -> list[Array]:
    xs = np.arange(-yard.length_m / 2, yard.length_m / 2 + 0.01, 2.6)
    rows = [(-1, 1)] if yard.width_m > 15 else [(-1,)]
    return [
        placed(
            [(x, side * yard.width_m / 2), (x, side * (yard.width_m / 2 - 5))], yard.east, yard.north, yard.heading_deg
        )
        for x in xs
        for side in rows[0]
    ]


def _joints(yard: Yard) -> list[Array]:
    a, b = yard.length_m / 2, yard.width_m / 2
    lines = [[(x, -b), (x, b)] for x in np.arange(-a, a, 5.0)] + [[(-a, y), (a, y)] for y in np.arange(-b, b, 5.0)]
    return [placed(line, yard.east, yard.north, yard.heading_deg) for line in lines]


def _outline(yard: Yard) -> Array:
    return placed(rectangle(yard.length_m, yard.width_m), yard.east, yard.north, yard.heading_deg)
