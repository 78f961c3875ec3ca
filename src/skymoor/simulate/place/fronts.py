# SPDX-License-Identifier: Apache-2.0
"""Facades as real streets have them: repeated, glazed or plain, with hedges, trees and parked cars before them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.simulate.building.openings import is_hall, wall_lengths
from skymoor.simulate.mesh import rectangle, stream
from skymoor.simulate.place.occupied import Occupied, placed
from skymoor.simulate.plan import Array, Building, Facade

REPEATED_SHARE, GLASS_SHARE, PLAIN_SHARE = 0.5, 0.18, 0.22  # of the buildings
COVER = (0.33, 0.58)  # of a ground floor, planned; rays meet 0.15 to 0.4, with gaps in crowns, and trees bare in winter
FULL_COVER = 0.8  # of one wall at most, where others have no room
MAX_TRIES = 80  # for each wall
# Length, depth, distance of the middle from the wall in metres, and the share of the ground floor's height that is
# hidden from eyes 10 m before the wall, as counted with rays.
SIZES = {
    "hedge": (5.2, 1.2, (3.2, 3.8), 0.25),
    "tall hedge": (5.2, 1.2, (3.2, 3.8), 0.6),
    "car": (4.9, 1.9, (3.7, 4.6), 0.4),
    "tree": (2.6, 2.0, (3.6, 5.2), 0.4),
}
KIND_SHARES = {"hedge": 0.1, "tall hedge": 0.2, "car": 0.35, "tree": 0.35}
TREE_HEIGHT_M, CROWN_SHARE = (4.2, 6.5), (0.28, 0.34)  # radius of the crown, as a share of the height


Thing = tuple[str, float, float, float]  # kind, east, north, heading


@dataclass(frozen=True, eq=False)
class Fronts:
    """What stands before facades: hedges as in `Plan.props`, parking places, and trees (n, 4) as in `Plan.trees`."""

    hedges: tuple[Thing, ...]
    parked: tuple[tuple[float, float, float], ...]
    trees: Array


NOTHING = Fronts((), (), np.zeros((0, 4)))


def varied(building: Building, seed: int) -> Building:
    """The building with a facade drawn for it; buildings of equal looks get the same, so that twins stay twins."""
    rng = stream(seed, "facade", building.looks)
    repeated, kind = bool(rng.uniform() < REPEATED_SHARE), float(rng.uniform())
    facade: Facade = "glass" if kind < GLASS_SHARE else "plain" if kind < GLASS_SHARE + PLAIN_SHARE else "windows"
    if facade == "plain":
        return replace(building, facade=facade, wall="brick", repeated=False)
    if facade == "glass" and is_hall(building):
        facade = "windows"
    return replace(building, facade=facade, repeated=repeated or building.repeated)


def put_fronts(buildings: tuple[Building, ...], ground: Occupied, seed: int) -> Fronts:
    """Things before the walls of these buildings, where there is room; marks their places as taken."""
    hedges, parked, trees = [], [], []
    for building in buildings:
        if building.water_up is not None:
            continue
        rng = stream(seed, "front", building.name)
        for kind, east, north, heading in _round(building, ground, rng):
            if kind == "tree":
                height = float(rng.uniform(*TREE_HEIGHT_M))
                trees.append((east, north, height, height * float(rng.uniform(*CROWN_SHARE))))
            elif kind == "car":
                parked.append((east, north, heading))
            else:
                hedges.append((kind, east, north, heading))
    return Fronts(tuple(hedges), tuple(parked), np.array(trees).reshape(-1, 4))


def _round(building: Building, ground: Occupied, rng: np.random.Generator) -> list[Thing]:
    """Things before all walls; what one wall has no room for comes before the next."""
    lengths, share = wall_lengths(building), float(rng.uniform(*COVER))
    found: list[Thing] = []
    missing_m = 0.0
    for turn in range(2):
        for wall, length in enumerate(lengths):
            wanted_m = min(missing_m + (share * length if turn == 0 else 0.0), FULL_COVER * length)
            things = _before(building, wall, wanted_m, ground, rng)
            found += things
            hidden_m = sum(SIZES[kind][0] * SIZES[kind][3] for kind, *_ in things)
            missing_m = max(missing_m + (share * length if turn == 0 else 0.0) - hidden_m, 0.0)
    return found


def _before(building: Building, wall: int, wanted_m: float, ground: Occupied, rng: np.random.Generator) -> list[Thing]:
    """Kind, east, north and heading of things before one wall, until `wanted_m` of its ground floor are hidden."""
    length = float(wall_lengths(building)[wall])
    corners = np.array(building.outline)
    start, along = corners[wall], (corners[(wall + 1) % len(corners)] - corners[wall]) / length
    outward = np.array([along[1], -along[0]])
    turn = float(np.degrees(np.arctan2(along[1], along[0])))
    heading = building.heading_deg + turn
    hidden_m = 0.0
    found: list[Thing] = []
    for _ in range(MAX_TRIES):
        kind = str(rng.choice(list(KIND_SHARES), p=list(KIND_SHARES.values())))
        long, deep, away, share = SIZES[kind]
        at, distance = float(rng.uniform(0.0, length)), float(rng.uniform(*away))
        # Half of a thing that is too long for what is missing is too much.
        if hidden_m + 0.5 * long * share > wanted_m:
            break
        plan = start + at * along + distance * outward
        east, north = placed(plan[None], building.east, building.north, building.heading_deg)[0]
        outline = placed(rectangle(long, deep), east, north, heading)
        if ground.free(outline):
            ground.take(outline)
            found.append((kind, float(east), float(north), float(heading)))
            hidden_m += long * share
    return found
