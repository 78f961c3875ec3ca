# SPDX-License-Identifier: Apache-2.0
"""What buildings each kind of site has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from skymoor.simulate.mesh import rectangle
from skymoor.simulate.options import Preset

Name = TypeVar("Name", bound=str)
Outline = tuple[tuple[float, float], ...]
Roof = Literal["flat", "gable", "hip", "shed", "sawtooth"]
Wall = Literal["brick", "plaster", "concrete", "metal", "panels"]
Cover = Literal["membrane", "gravel", "tiles", "metal"]


@dataclass(frozen=True)
class Block:
    """A building without a place."""

    outline: Outline
    storeys: int
    storey_m: float
    roof: Roof
    wall: Wall
    cover: Cover
    looks: int

    def smaller(self) -> Block:
        """Two thirds of the size, for the gaps that are left."""
        return replace(self, outline=tuple((0.67 * x, 0.67 * y) for x, y in self.outline))


@dataclass(frozen=True)
class Blocks:
    """What to draw from: lengths and widths in metres, shares of shapes, roofs and walls."""

    per_hectare: float
    yard: Literal["parking", "concrete"] | None
    length_m: tuple[float, float]
    width_m: tuple[float, float]
    storeys: tuple[int, int]
    storey_m: tuple[float, float]
    wings: float  # share of buildings with L, T or U outlines
    roofs: Mapping[Roof, float]
    walls: Mapping[Wall, float]
    tiled: bool = False  # every pitched roof has tiles

    def draw(self, rng: np.random.Generator) -> Block:
        """One building."""
        length, width = rng.uniform(*self.length_m), rng.uniform(*self.width_m)
        winged = rng.uniform() < self.wings
        roof = "flat" if winged else _pick(rng, self.roofs)
        wall = _pick(rng, self.walls)
        cover: Cover = "tiles" if self.tiled and roof != "flat" else _cover(rng, roof, wall)
        storeys = int(rng.integers(self.storeys[0], self.storeys[1] + 1))
        outline = _winged(rng, length, width) if winged else tuple(rectangle(length, width))
        looks = int(rng.integers(1 << 31))
        return Block(outline, storeys, float(rng.uniform(*self.storey_m)), roof, wall, cover, looks)


BLOCKS: Mapping[Preset, Blocks] = {
    "office-park": Blocks(
        per_hectare=4.6,
        yard="parking",
        length_m=(18, 34),
        width_m=(11, 17),
        storeys=(1, 4),
        storey_m=(3.1, 3.7),
        wings=0.4,
        roofs={"flat": 0.7, "gable": 0.12, "hip": 0.13, "shed": 0.05},
        walls={"brick": 0.35, "plaster": 0.25, "concrete": 0.2, "panels": 0.2},
    ),
    "industrial": Blocks(
        per_hectare=2.6,
        yard="concrete",
        length_m=(26, 46),
        width_m=(15, 24),
        storeys=(1, 3),
        storey_m=(4.0, 5.0),
        wings=0.2,
        roofs={"flat": 0.4, "gable": 0.2, "shed": 0.15, "sawtooth": 0.25},
        walls={"metal": 0.45, "brick": 0.2, "concrete": 0.2, "panels": 0.15},
    ),
    "flooded": Blocks(
        per_hectare=3.4,
        yard="parking",
        length_m=(13, 26),
        width_m=(9, 14),
        storeys=(2, 3),
        storey_m=(3.0, 3.6),
        wings=0.25,
        roofs={"flat": 0.35, "gable": 0.35, "hip": 0.25, "shed": 0.05},
        walls={"brick": 0.4, "plaster": 0.35, "concrete": 0.15, "panels": 0.1},
    ),
    "hillside": Blocks(
        per_hectare=7.5,
        yard=None,
        length_m=(10, 20),
        width_m=(8, 12),
        storeys=(1, 3),
        storey_m=(2.8, 3.2),
        wings=0.1,
        roofs={"flat": 0.2, "gable": 0.45, "hip": 0.3, "shed": 0.05},
        walls={"brick": 0.3, "plaster": 0.6, "concrete": 0.1},
    ),
    "old-houses": Blocks(
        per_hectare=11.0,
        yard=None,
        length_m=(8, 13),
        width_m=(7, 9.5),
        storeys=(1, 2),
        storey_m=(2.8, 3.2),
        wings=0.0,
        roofs={"gable": 0.6, "hip": 0.4},
        walls={"brick": 0.6, "plaster": 0.4},
        tiled=True,
    ),
}


def _cover(rng: np.random.Generator, roof: Roof, wall: Wall) -> Cover:
    if roof == "flat":
        return _pick(rng, {"membrane": 0.6, "gravel": 0.4})
    return _pick(rng, {"metal": 0.75, "tiles": 0.25} if wall == "metal" else {"metal": 0.25, "tiles": 0.75})


def _winged(rng: np.random.Generator, length: float, width: float) -> Outline:
    """L, T or U, with wings about as deep as the main house."""
    a, b = length / 2, width / 2
    depth, wing = float(rng.uniform(7, 12)), float(rng.uniform(8, 11))
    top = b + depth
    shapes = {
        "L": [(-a, -b), (a, -b), (a, top), (a - wing, top), (a - wing, b), (-a, b)],
        "T": [(-a, -b), (a, -b), (a, b), (wing / 2, b), (wing / 2, top), (-wing / 2, top), (-wing / 2, b), (-a, b)],
        "U": [(-a, -b), (a, -b), (a, top), (a - wing, top), (a - wing, b), (wing - a, b), (wing - a, top), (-a, top)],
    }
    outline = np.array(shapes[str(rng.choice(list(shapes)))])
    outline -= (outline.min(axis=0) + outline.max(axis=0)) / 2
    return tuple((float(x), float(y)) for x, y in outline)


def _pick(rng: np.random.Generator, shares: Mapping[Name, float]) -> Name:
    names = list(shares)
    return names[int(rng.choice(len(names), p=np.array(list(shares.values())) / sum(shares.values())))]
