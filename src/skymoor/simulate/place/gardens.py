# SPDX-License-Identifier: Apache-2.0
"""Old trees of a street of old houses: large, close to the houses, along the streets and in the gardens."""

from __future__ import annotations

import numpy as np

from skymoor.simulate.mesh import rectangle, stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.place.occupied import Occupied, placed
from skymoor.simulate.plan import Array, Building, Strip

HEIGHT_M = (12.0, 20.0)
CROWN_M = (4.6, 7.0)  # radius
GARDENS_PER_HECTARE = 220.0
HOUSE_TREES = 3  # tried at each house; from 3.7 m before the walls on, so that crowns reach over the roof
STREET_STEP_M, STREET_SHARE = 13.0, 0.7
OPEN_M = 19.0  # round the middle of a building that is photographed from the ground
TRUNK_M = 2.2  # side of the square that a trunk needs
APART = 0.5  # distance of two trunks at least, in sums of their crowns' radii


def plant_old_trees(
    options: SiteOptions,
    ground: Occupied,
    extent: float,
    buildings: list[Building],
    strips: tuple[Strip, ...],
    walked: list[Building],
) -> Array:
    """Trees (n, 4): east, north, height, crown radius. Whoever comes first has the room: houses, streets, gardens.

    Gardens of `walked` buildings are open, so that people with cameras find a way round the house.
    """
    rng = stream(options.key, "trees")
    count = int(GARDENS_PER_HECTARE * (2 * extent / 100) ** 2)
    gardens = rng.uniform(-extent, extent, (count, 2))
    for building in walked:
        gardens = gardens[np.hypot(*(gardens - [building.east, building.north]).T) > OPEN_M]
    plan = np.concatenate([*(_beside(b, rng) for b in buildings), *(_along(s, rng) for s in strips), gardens])
    plan = plan[(np.abs(plan) < extent).all(axis=1)]
    trees = np.zeros((len(plan), 4))
    found = 0
    for east, north in plan:
        height = rng.uniform(*HEIGHT_M)
        radius = float(np.clip(height * rng.uniform(0.34, 0.42), *CROWN_M))
        others = trees[:found]
        near = np.hypot(others[:, 0] - east, others[:, 1] - north) < APART * (others[:, 3] + radius)
        if near.any() or not ground.free(placed(rectangle(TRUNK_M, TRUNK_M), east, north, 0)):
            continue
        trees[found] = (east, north, height, radius)
        ground.take(placed(rectangle(1.5, 1.5), east, north, 0))
        found += 1
    return trees[:found]


def _beside(building: Building, rng: np.random.Generator) -> Array:
    """Places (n, 2) close before the walls of a building with a rectangular outline."""
    a, b = np.max(building.outline, axis=0)
    gap = rng.uniform(3.8, 5.2, HOUSE_TREES)
    side, along = rng.permutation(4)[:HOUSE_TREES], rng.uniform(-0.8, 0.8, HOUSE_TREES)
    x = np.where(side % 2 == 0, along * a, np.where(side == 1, a + gap, -a - gap))
    y = np.where(side % 2 == 1, along * b, np.where(side == 0, b + gap, -b - gap))
    return placed(np.column_stack([x, y]), building.east, building.north, building.heading_deg)


def _along(strip: Strip, rng: np.random.Generator) -> Array:
    """Places (n, 2) in rows on both sides of a street, some of them left out."""
    line = np.array(strip.line)
    step = np.diff(line, axis=0)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*step.T))])
    places = []
    for side in (-1.0, 1.0):
        at = np.arange(rng.uniform(0, STREET_STEP_M), length[-1], STREET_STEP_M)
        at = at[rng.uniform(size=len(at)) < STREET_SHARE] + rng.normal(scale=0.8)
        at = np.clip(at, 0, length[-1] - 1e-6)
        k = np.searchsorted(length, at, side="right") - 1
        ahead = step[k] / np.hypot(*step[k].T)[:, None]
        out = side * (strip.width_m / 2 + 4.2) * np.column_stack([ahead[:, 1], -ahead[:, 0]])
        places.append(line[k] + (at - length[k])[:, None] * ahead + out)
    return np.concatenate(places)
