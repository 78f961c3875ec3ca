# SPDX-License-Identifier: Apache-2.0
"""People who walk round a building with a phone, and the security cameras that see the same walls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geometry import Intrinsics, Similarity
from skymoor.simulate.capture.aim import azimuth_deg, looking, make_lens, standing_at
from skymoor.simulate.capture.footing import (
    STEP_M,
    Circuit,
    circuit_round,
    clear_views,
    free_places,
    ground_up,
    within_buildings,
)
from skymoor.simulate.light.motion import Motion
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import stream
from skymoor.simulate.plan import Building, dates_of
from skymoor.simulate.world import World

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DISTANCES_M = np.arange(8.0, 13.1, 0.5)  # from the wall
LEADS_M = (-6.5, -3.0, 0.0, 0.0, 0.0, 3.0, 6.5)  # by which people look back or ahead along a wall
POLES_M = np.arange(11.0, 17.1, 1.0)
NEAR_POLES_M = np.arange(7.0, 10.6, 0.5)  # where trees leave no room farther away, or walls are small
MOUNT_M = 0.35  # between a camera and the wall that it hangs on
MOUNTS_M = (8.0, 30.0)  # between that wall and the one that it looks at
BESIDE_M = 1.0  # between a pole and a wall
APART_M = 2.0
MAX_TRIES = 200
SECURITY_WALL_SHARE = 0.15  # their lenses are wide, and they see much ground


@dataclass(frozen=True, eq=False)
class Walk:
    """Where a group has gone: poses in order, and the places of the circuit that they were taken from."""

    building: Building
    circuit: Circuit
    scene: Scene
    lens: Intrinsics
    eye_m: float
    stations: tuple[tuple[int, float], ...]  # place on the circuit, metres from the wall
    poses: tuple[Similarity, ...] = ()
    pieces: tuple[int, ...] = ()  # of a walk with gaps: the number of the piece that each pose belongs to
    motions: tuple[Motion, ...] = ()

    @property
    def walls(self) -> Array:
        """The points (n, 2) of the walls opposite the stations."""
        return self.circuit.wall[[place for place, _ in self.stations]]


@lru_cache(maxsize=8)
def walk_of(world: World, group: int) -> Walk:
    """The walk of a group of `options.group_photos` photos.

    Raises `InputError` when there is no building left to walk round, or not enough room round it.
    """
    options, names = world.options, world.plan.walked
    if group >= len(names):
        raise InputError(f"groups = {options.groups}: the site has {len(names)} buildings to walk round; ask for fewer")
    building = next(b for b in world.plan.buildings if b.name == names[group])
    rng = stream(options.key, "walk", group)
    distortion = (float(rng.uniform(-0.02, 0.06)), float(rng.uniform(-0.06, 0.0)), 0.0, 0.0)
    lens = make_lens(options, rng, float(rng.uniform(0.70, 0.85)), distortion)
    eye_m = float(rng.uniform(1.55, 1.72))
    circuit, scene = circuit_round(building.outline_enu), world.scene(dates_of(options).ground)
    eyes = lifted(world, circuit.places(DISTANCES_M).reshape(-1, 2), eye_m)
    free = free_places(world, scene, eyes)
    inward = np.repeat(azimuth_deg(-circuit.outward), len(DISTANCES_M))
    free[free] = clear_views(scene, lens, eyes[free], looking(inward[free], 5.0))
    stations = _stations(circuit, free.reshape(-1, len(DISTANCES_M)), options.group_photos, building, rng)
    if len(stations) < options.group_photos:
        raise InputError(
            f"group_photos = {options.group_photos}: {len(stations)} have room round {building.name}; ask for fewer"
        )
    walk = Walk(building, circuit, scene, lens, eye_m, stations)
    poses = tuple(_held(world, walk, place, distance, rng) for place, distance in stations)
    return Walk(building, circuit, scene, lens, eye_m, stations, poses)


def watching(world: World, walk: Walk, lens: Intrinsics, rng: np.random.Generator, taken: list[Array]) -> Similarity:
    """A security camera that sees a wall of a walk from above: on a pole before it, or on a neighbour's wall.

    `taken` are the centres (3,) of other cameras. Raises `InputError` when there is no room.
    """
    for poles_m in (POLES_M, NEAR_POLES_M):
        found = _watching_from(world, walk, lens, rng, taken, poles_m)
        if found is not None:
            return found
    raise InputError(
        f"security = {world.options.security}: no more cameras have room round {walk.building.name}; ask for fewer"
    )


def _watching_from(
    world: World, walk: Walk, lens: Intrinsics, rng: np.random.Generator, taken: list[Array], poles_m: Array
) -> Similarity | None:
    poles = walk.circuit.places(poles_m)[[place for place, _ in walk.stations]].reshape(-1, 2)
    poles = poles[~within_buildings(world, poles, margin_m=BESIDE_M)]
    mounts = _mounts(world, walk)
    plan = np.concatenate([poles, mounts])
    # Every other camera looks for a wall first.
    wish = rng.uniform(size=len(plan)) + (np.arange(len(plan)) >= len(poles)) * (rng.uniform() < 0.5)
    plan = plan[np.argsort(-wish)][:MAX_TRIES]
    eyes = lifted(world, plan, rng.uniform(3.0, 5.0, len(plan)))
    aims = walk.walls[rng.choice(len(walk.walls), len(plan))]
    down, roll = rng.uniform(10.0, 25.0, len(plan)), rng.normal(scale=1.0, size=len(plan))
    rotations = looking(azimuth_deg(aims - plan), -down, roll)
    good = clear_views(walk.scene, lens, eyes, rotations, wall_share=SECURITY_WALL_SHARE)
    for other in taken:
        good &= np.linalg.norm(eyes - other, axis=1) > APART_M
    if not good.any():
        return None
    first = int(np.argmax(good))
    return standing_at(eyes[first], rotations[first])


def _stations(
    circuit: Circuit, free: Mask, count: int, building: Building, rng: np.random.Generator
) -> tuple[tuple[int, float], ...]:
    """Places of a walk round that corner with the most room; `free` (m, n) is by place and distance.

    Where something stands in the way, people walk nearer to the wall or farther from it, or walk on. With many photos
    they go all the way round, and once more where they have missed some.
    """
    m, free = len(free), free.copy()
    step = float(rng.uniform(2.65, 3.15)) / STEP_M
    around = count * step > 0.75 * m
    step = m / count if around else step
    reach = np.arange(round(count * step)) - round(count * step / 2)
    corners = np.asarray(np.linalg.norm(circuit.wall[:, None] - building.outline_enu, axis=2).argmin(axis=0))
    room = np.asarray(free.any(axis=1))[(corners[:, None] + reach) % m].sum(axis=1) + rng.uniform(size=len(corners))
    first = int(corners[np.argmax(room)] + reach[0])
    wanted_m, swing_m, phase = rng.uniform(9.0, 11.5), rng.uniform(0.3, 1.2), rng.uniform(0, 2 * np.pi)
    near = np.arange(-2, 3)
    chosen: list[tuple[int, float]] = []
    for k in np.arange(first, first + m * (2 if around else 1), step):
        places = (round(float(k)) + near) % m
        prefer = wanted_m + swing_m * np.sin(2 * np.pi * k * STEP_M / 25 + phase)
        cost = (near[:, None] * STEP_M) ** 2 + 0.5 * (DISTANCES_M - prefer) ** 2
        cost = np.where(free[places], cost, np.inf)
        row, column = (int(x) for x in np.unravel_index(np.argmin(cost), cost.shape))
        if np.isfinite(cost[row, column]):
            chosen.append((int(places[row]), float(DISTANCES_M[column])))
            free[places[row]] = False
        if len(chosen) == count:
            break
    return tuple(chosen)


def _held(world: World, walk: Walk, place: int, distance_m: float, rng: np.random.Generator) -> Similarity:
    """One photo: people look at the wall or along it, hold the phone not quite level, and lift it now and then."""
    circuit = walk.circuit
    plan = circuit.wall[place] + distance_m * circuit.outward[place] + rng.normal(scale=0.08, size=2)
    lift = walk.eye_m + float(rng.normal(scale=0.04)) + (0.35 if rng.uniform() < 0.15 else 0.0)
    eye = lifted(world, plan[None], lift)
    up = np.degrees(np.arctan2(0.45 * walk.building.walls_m - walk.eye_m, distance_m))
    pitch, roll = float(np.clip(up, 2, 12) + rng.normal(scale=2.0)), float(rng.normal(scale=2.0))
    lead, wander = float(rng.choice(LEADS_M)), float(rng.normal(scale=4.0))
    ahead = circuit.wall[(place + round(lead / STEP_M)) % len(circuit.wall)]
    turned = looking(azimuth_deg(ahead - plan) + wander, pitch, roll)
    if clear_views(walk.scene, walk.lens, eye, turned[None])[0]:
        return standing_at(eye[0], turned)
    # The way straight at the wall is known to be free.
    return standing_at(eye[0], looking(azimuth_deg(-circuit.outward[place]), 5.0, roll))


def _mounts(world: World, walk: Walk) -> Array:
    """Plan positions (n, 2) close before walls of other buildings, not far from the walls of the walk."""
    found = [np.zeros((0, 2))]
    for building in (*world.plan.buildings, *world.plan.distractors):
        if building.name != walk.building.name:
            places = circuit_round(building.outline_enu).places([MOUNT_M])[::2, 0]
            apart = np.linalg.norm(places[:, None] - walk.walls, axis=2).min(axis=1)
            found.append(places[(apart > MOUNTS_M[0]) & (apart < MOUNTS_M[1])])
    mounts = np.concatenate(found)
    return mounts[~within_buildings(world, mounts, margin_m=0.5 * MOUNT_M)]


def lifted(world: World, plan: Array, height_m: float | Array) -> Array:
    """Points (n, 3) above the ground or the water."""
    return np.column_stack([plan, ground_up(world, plan) + height_m])
