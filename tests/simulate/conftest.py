# SPDX-License-Identifier: Apache-2.0
"""A site of six plain blocks on a meadow: what the simulator's outer parts need of a world, made in no time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.simulate.light.pages import Pages
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import Label, Part, cuboid, join, quads, rectangle
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import Building, Date, Strip
from skymoor.simulate.world import World

Array = NDArray[np.float64]

EXTENT_M = 130.0
SLOPE = 0.02
BLOCKS = (  # name, east, north, heading, length, width, storeys
    ("west", -28.0, 4.0, 20.0, 24.0, 12.0, 2),
    ("east", 30.0, -6.0, -35.0, 20.0, 14.0, 3),
    ("north", 4.0, 34.0, 75.0, 16.0, 10.0, 1),
    ("south", 2.0, -34.0, 0.0, 18.0, 10.0, 2),
)
ROAD = ((-45.0, 19.5), (45.0, 19.5))
TREE = (-8.0, -8.0, 7.0, 2.5)  # east, north, height, crown radius


@dataclass(frozen=True)
class BlockWorld:
    """Stands in for `World`."""

    options: SiteOptions

    @property
    def plan(self) -> Any:
        buildings = tuple(_building(*block) for block in BLOCKS)
        return SimpleNamespace(
            buildings=buildings[:3],
            distractors=buildings[3:],
            strips=(Strip(ROAD, 6.0, "road"),),
            trees=np.array([TREE]),
            water_up=None,
            walked=("west", "east"),
            extent_m=EXTENT_M,
        )

    def height(self, east: Array, north: Array) -> Array:
        return np.asarray(SLOPE * np.asarray(east) + 0.0 * np.asarray(north))

    def scene(self, date: Date) -> Scene:
        return _scene(date)


def _make_world(**options: Any) -> World:
    """A world of blocks with small photos and a small reference, unless the options say otherwise."""
    small = {"airborne": 6, "group_photos": 4, "security": 2, "photo_width": 80, "samples": 1, "radius_m": 45.0}
    reference = {"reference_width_m": 120.0, "ortho_pixel_m": 1.0, "dsm_pixel_m": 1.0}
    return cast(World, BlockWorld(SiteOptions(**{**small, **reference, **options})))


@pytest.fixture(scope="session")
def make_world() -> Callable[..., World]:
    """Makes a world of given options; small ones by default."""
    return _make_world


@pytest.fixture(scope="session")
def world() -> World:
    """With the small options."""
    return _make_world()


def _building(
    name: str, east: float, north: float, heading: float, length: float, width: float, storeys: int
) -> Building:
    outline = tuple(rectangle(length, width))
    up = SLOPE * east
    return Building(name, east, north, up, heading, outline, storeys, 3.2, "flat", "brick", "membrane", looks=1)


@lru_cache(maxsize=4)
def _scene(date: Date) -> Scene:
    rng = np.random.default_rng(3)
    pages = Pages()
    noise = rng.uniform(0.1, 0.6, (256, 256, 1)) * [1.0, 0.9, 0.8]
    page = pages.add(noise.astype(np.float32), 0.25)
    parts: list[Part] = [_meadow(page)]
    for block in BLOCKS:
        building = _building(*block)
        edges = np.diag([block[4], block[5], building.walls_m + 2.0])
        wall = cuboid([-block[4] / 2, -block[5] / 2, -2.0], edges, page, Label.WALL, sides=5)
        parts.append(wall.placed(building.heading_deg, [building.east, building.north, building.up]))
    east, north, height, radius = TREE
    crown = cuboid([-radius, -radius, 2.0], np.diag([2 * radius, 2 * radius, height - 2]), page, Label.PLANT)
    leafy = crown.placed(0.0, [east, north, SLOPE * east])
    flat = np.zeros((8, 8), np.float32)
    grain = pages.add(np.full((8, 8, 3), 0.5, np.float32), 0.01)
    ripples = np.zeros((8, 8, 2), np.float32)
    return Scene(join(parts), leafy, pages, grain, date.sun, flat, date.haze, ripples, lattice=(50.0, -3.0, 12.0))


def _meadow(page: int) -> Part:
    plan = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (EXTENT_M + 20)
    corners = np.column_stack([plan, SLOPE * plan[:, 0]])
    return quads(corners, plan, page, Label.GROUND)
