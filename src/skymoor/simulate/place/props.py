# SPDX-License-Identifier: Apache-2.0
"""What stands outdoors for good: lamps, benches, tanks, containers and the like."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.light.pages import WHITE, Pages
from skymoor.simulate.mesh import Label, Part, cuboid, cylinder, join, quads, stream
from skymoor.simulate.place.layout import Plan
from skymoor.simulate.place.noise import periodic
from skymoor.simulate.plan import Array32

BOXES = ((0.26, 0.10, 0.07), (0.07, 0.14, 0.22), (0.14, 0.17, 0.12), (0.30, 0.30, 0.29), (0.28, 0.19, 0.06))
STEEL, WOOD, RACK = (0.30, 0.31, 0.32), (0.26, 0.19, 0.11), (0.9, 0.75, 0.6)


def props(plan: Plan, pages: Pages, seed: int) -> Part:
    """What the plan lists, for good; hedges are plants and not among them."""
    rust = pages.add(_rust(stream(seed, "rust")), 0.02)
    make = {
        "lamp": _lamp, "bench": _bench, "bin": _bin, "shed": _shed, "tank": _tank,
        "silo": _silo, "container": _container, "pallets": _pallets, "pipes": _pipes,
    }  # fmt: skip
    parts = []
    for k, (kind, east, north, heading) in enumerate(plan.props):
        if kind in make:
            up = float(plan.land.height(east, north)) - 0.05
            parts.append(make[kind](rust, stream(seed, "prop", k)).placed(heading, [east, north, up]))
    return join(parts)


def _block(
    middle: tuple[float, float], size: tuple[float, float, float], page: int, tint: ArrayLike, low: float = 0.0
) -> Part:
    """An upright box on `low`, its middle at (x, y)."""
    x, y, z = size
    origin = [middle[0] - x / 2, middle[1] - y / 2, low]
    return cuboid(origin, np.diag([x, y, z]), page, Label.OBJECT, tint, sides=5)


def _lamp(rust: int, rng: np.random.Generator) -> Part:
    height = float(rng.uniform(5, 8))
    pole = cylinder([0, 0, 0], 0.09, height, WHITE, Label.OBJECT, STEEL, facets=7, top_radius=0.05)
    arm = _block((0.6, 0), (1.3, 0.06, 0.06), WHITE, STEEL, height - 0.06)
    return join([pole, arm, _block((1.2, 0), (0.6, 0.25, 0.12), WHITE, STEEL, height - 0.1)])


def _bench(rust: int, rng: np.random.Generator) -> Part:
    wood = np.array([0.20, 0.13, 0.07]) * rng.uniform(0.7, 1.2)
    slats = [_block((0, y), (1.8, 0.11, 0.05), WHITE, wood, 0.43) for y in (-0.2, -0.05, 0.1)]
    back = [_block((0, 0.25), (1.8, 0.04, 0.12), WHITE, wood, z) for z in (0.6, 0.78)]
    return join([*slats, *back, *(_block((x, 0), (0.08, 0.45, 0.45), WHITE, STEEL) for x in (-0.7, 0.7))])


def _bin(rust: int, rng: np.random.Generator) -> Part:
    tint = np.array([(0.05, 0.12, 0.06), (0.16, 0.16, 0.17), (0.10, 0.09, 0.20)][rng.integers(3)])
    return join([_block((x, 0), (0.6, 0.75, 1.1), rust, 2 * tint) for x in (-0.4, 0.35)[: rng.integers(1, 3)]])


def _shed(rust: int, rng: np.random.Generator) -> Part:
    tint = np.array([0.75, 0.6, 0.45]) * rng.uniform(0.6, 1.3)
    roof = np.array([[[-1.8, -1.4, 2.3], [1.8, -1.4, 2.3], [1.8, 0, 2.9], [-1.8, 0, 2.9]],
                     [[-1.8, 1.4, 2.3], [1.8, 1.4, 2.3], [1.8, 0, 2.9], [-1.8, 0, 2.9]]])  # fmt: skip
    cover = quads(roof, roof[..., :2] + 2, rust, Label.ROOF, (0.6, 0.55, 0.5))
    return join([_block((0, 0), (3.4, 2.5, 2.35), rust, tint), cover])


def _tank(rust: int, rng: np.random.Generator) -> Part:
    radius, height = float(rng.uniform(3.2, 5.8)), float(rng.uniform(4.5, 9.5))
    tint = np.array([1.5, 1.5, 1.45]) * rng.uniform(0.8, 1.1)
    wall = cylinder([0, 0, -0.5], radius, height + 0.5, rust, Label.OBJECT, tint, facets=36)
    top = cylinder([0, 0, height], radius, 0.7, rust, Label.OBJECT, tint, facets=36, top_radius=0.4, cap=Label.OBJECT)
    rail = cylinder([0, 0, height + 0.9], radius, 0.06, WHITE, Label.OBJECT, (0.4, 0.33, 0.05), facets=36)
    levels = (1.5, height * 0.6)
    hoops = [cylinder([0, 0, z], radius + 0.05, 0.12, WHITE, Label.OBJECT, STEEL, facets=36) for z in levels]
    ladder = _block((radius + 0.25, 0), (0.1, 0.5, height), WHITE, STEEL)
    return join([wall, top, rail, *hoops, ladder])


def _silo(rust: int, rng: np.random.Generator) -> Part:
    height = float(rng.uniform(8, 13))
    tint = np.array([1.4, 1.38, 1.3]) * rng.uniform(0.8, 1.1)
    parts = []
    for x in (-1.55, 1.55)[: rng.integers(1, 3)]:
        for up, radius, tall, top in ((0.9, 0.3, 1.3, 1.4), (2.2, 1.4, height - 2.2, 1.4), (height, 1.4, 1.0, 0.2)):
            parts.append(cylinder([x, 0, up], radius, tall, rust, Label.OBJECT, tint, facets=20, top_radius=top))
        parts += [_block((x + a, b), (0.2, 0.2, 2.5), WHITE, STEEL) for a in (-1, 1) for b in (-0.95, 0.95)]
    return join(parts)


def _container(rust: int, rng: np.random.Generator) -> Part:
    parts = []
    for level in range(int(rng.integers(1, 3))):
        tint = 2.2 * np.array(BOXES[rng.integers(len(BOXES))]) * rng.uniform(0.8, 1.2)
        box = _block((rng.normal(scale=0.1), 0), (6.06, 2.44, 2.59), rust, tint, 2.6 * level)
        low = 2.6 * level + 0.1
        ribs = [_block((x, 0), (0.09, 2.52, 2.4), rust, 0.85 * tint, low) for x in np.arange(-2.8, 3, 0.56)]
        parts += [box, *ribs]
    return join(parts)


def _pallets(rust: int, rng: np.random.Generator) -> Part:
    parts = []
    for x in (-0.75, 0.6):
        wood = np.array(WOOD) * rng.uniform(0.7, 1.2)
        for level in range(int(rng.integers(1, 9))):
            dx, dy = rng.normal(scale=0.03, size=2)
            parts.append(_block((x + dx, dy), (1.2, 0.8, 0.11), WHITE, wood, 0.15 * level))
        if rng.uniform() < 0.5:
            load = 2 * np.array(BOXES[rng.integers(len(BOXES))])
            parts.append(_block((x, 0), (1.1, 0.75, 0.9), rust, load, 0.15 * 9))
    return join(parts)


def _pipes(rust: int, rng: np.random.Generator) -> Part:
    """A rack with pipes along x."""
    posts = [_block((x, y), (0.2, 0.2, 4.2), rust, RACK) for x in (-6, -2, 2, 6) for y in (-0.8, 0.8)]
    beams = [_block((x, 0), (0.2, 1.9, 0.2), rust, RACK, 4.0) for x in (-6, -2, 2, 6)]
    tubes = []
    for y in (-0.6, -0.2, 0.35):
        size = float(rng.uniform(0.1, 0.22))
        tint = rng.uniform(0.9, 1.8) * np.array([1, 0.98, 0.93])
        tubes.append(_block((0, y), (13, 2 * size, 2 * size), rust, tint, 4.2))
    return join([*posts, *beams, *tubes])


def _rust(rng: np.random.Generator) -> Array32:
    """Painted metal (300, 300, 3), about 0.42, with runs of rust; it repeats."""
    fine, wide = periodic(rng, 300, 2, 1.0), periodic(rng, 300, 6, 1.8)
    runs = np.clip(periodic(rng, 300, 3, 1.4) - 1.2, 0, 1)[..., None]
    paint = 0.42 * np.exp(0.10 * wide + 0.06 * fine)[..., None] * np.ones(3)
    return np.asarray(paint * (1 - runs) + runs * np.array([0.20, 0.11, 0.06]), dtype=np.float32)
