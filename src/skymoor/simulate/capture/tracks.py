# SPDX-License-Identifier: Apache-2.0
"""The lines along which cameras are carried: round buildings and along roads, with the places that are free."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skymoor.simulate.capture.carriers import Carrier
from skymoor.simulate.capture.footing import STEP_M, Circuit, circuit_round, free_places, ground_up
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.plan import Building, Strip
from skymoor.simulate.world import World

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FROM_WALL_M = np.arange(6.0, 24.1, 1.0)
STANDING_M = (0.8, 4.5)  # plausible heights of a camera above what is below it
ROAD_REACH_M = 30.0  # how far from a road facades are driven past
LANE_SHARE = 0.25  # of the road's width, from its middle
CORNER_DEG, CORNER_REACH = 10.0, 3  # a track turns by more within so many steps to either side


@dataclass(frozen=True, eq=False)
class Track:
    """Places k of a line, one each `STEP_M`.

    `plan` (m, n, 2) are the places at n distances from the facade, `free` (m, n) where a camera can be, `to_wall`
    (m, 2) the unit direction towards the facade, `travel` (m, 2) that of the way. `building` is what it leads round.
    """

    plan: Array
    free: Mask
    to_wall: Array
    travel: Array
    building: Building | None = None

    @property
    def straight(self) -> Mask:
        """Whether the way (m,) does not turn here."""
        before, after = np.roll(self.travel, CORNER_REACH, axis=0), np.roll(self.travel, -CORNER_REACH, axis=0)
        return np.asarray(np.sum(before * after, axis=1) > np.cos(np.radians(CORNER_DEG)))

    def from_place(self, first: int) -> Track:
        """The same, closed, line from another place on."""
        order = np.roll(np.arange(len(self.plan)), -first)
        return Track(self.plan[order], self.free[order], self.to_wall[order], self.travel[order], self.building)

    def reversed(self) -> Track:
        """The same line the other way."""
        return Track(self.plan[::-1], self.free[::-1], self.to_wall[::-1], -self.travel[::-1], self.building)


def tracks_of(world: World, scene: Scene, carrier: Carrier, first: Building, sun: Array) -> Iterator[Track]:
    """Lines for a group that begins at a building, and goes on along its neighbours until it has enough photos.

    The first circuit begins where about half of the facades that follow are in shade; `sun` (3,) points to it.
    """
    middle = np.array([first.east, first.north])
    others = [b for b in world.plan.buildings if b.name not in world.plan.walked]
    others.sort(key=lambda b: float(np.hypot(*(middle - [b.east, b.north]))))
    if carrier.on_roads:
        yield from _roads(world, scene, carrier, middle)
    for building in (first, *others):
        circuit = circuit_round(building.outline_enu)
        track = _round(world, scene, carrier, circuit, building)
        track = track.from_place(_half_shaded(circuit, sun))
        yield track.reversed() if carrier.reverse else track


def _round(world: World, scene: Scene, carrier: Carrier, circuit: Circuit, building: Building) -> Track:
    plan = circuit.places(FROM_WALL_M)
    out = circuit.outward
    return Track(plan, _free(world, scene, plan, carrier), -out, np.column_stack([-out[:, 1], out[:, 0]]), building)


def _roads(world: World, scene: Scene, carrier: Carrier, middle: Array) -> Iterator[Track]:
    """Lanes of the roads within the site, the nearest first."""
    radius = world.options.radius_m
    strips = [strip for strip in world.plan.strips if strip.kind == "road"]
    strips.sort(key=lambda strip: float(np.linalg.norm(np.array(strip.line) - middle, axis=1).min()))
    for strip in strips:
        plan, travel = _lane(strip, carrier)
        inside = (np.abs(plan) < radius).all(axis=1)
        if inside.sum() * STEP_M < ROAD_REACH_M:
            continue
        plan, travel = plan[inside], travel[inside]
        to_wall, near = _facades_beside(world, plan, travel)
        free = _free(world, scene, plan[:, None], carrier) & near[:, None]
        yield Track(plan[:, None], free, to_wall, travel)


def _lane(strip: Strip, carrier: Carrier) -> tuple[Array, Array]:
    """Places (m, 2) and directions (m, 2) of the lane on which a vehicle drives along a road."""
    line = np.array(strip.line)[:: -1 if carrier.reverse else 1]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, along[-1], STEP_M)
    plan = np.column_stack([np.interp(at, along, line[:, k]) for k in (0, 1)])
    travel = np.gradient(plan, axis=0)
    travel /= np.linalg.norm(travel, axis=1, keepdims=True)
    return plan + LANE_SHARE * strip.width_m * np.column_stack([travel[:, 1], -travel[:, 0]]), travel


def _facades_beside(world: World, plan: Array, travel: Array) -> tuple[Array, Mask]:
    """Directions (m, 2) across the way to the side of the nearest building, and whether one is near enough."""
    corners = np.concatenate([b.outline_enu for b in world.plan.buildings])
    apart = corners[None] - plan[:, None]
    distance = np.linalg.norm(apart, axis=2)
    nearest = apart[np.arange(len(plan)), distance.argmin(axis=1)]
    left = np.column_stack([-travel[:, 1], travel[:, 0]])
    side = np.sign(np.sum(left * nearest, axis=1, keepdims=True))
    return np.where(side == 0, 1.0, side) * left, distance.min(axis=1) < ROAD_REACH_M


def _free(world: World, scene: Scene, plan: Array, carrier: Carrier) -> Mask:
    """Whether a camera can be at places (m, n, 2)."""
    flat = plan.reshape(-1, 2)
    eyes = np.column_stack([flat, ground_up(world, flat) + carrier.eye_m])
    return free_places(world, scene, eyes, eye_m=STANDING_M).reshape(plan.shape[:2])


def _half_shaded(circuit: Circuit, sun: Array) -> int:
    """The place from which on half of the walls are turned away from the sun after any way that is not too short."""
    lit = (circuit.outward @ sun[:2] > 0).astype(np.float64)
    m = len(lit)
    reach = np.unique((np.array([0.25, 0.4, 0.6, 1.0]) * m).astype(int))
    total = np.concatenate([[0.0], np.cumsum(np.concatenate([lit, lit]))])
    first = np.arange(m)
    uneven = sum(np.abs((total[first + r] - total[first]) / r - 0.5) for r in reach)
    return int(np.argmin(uneven))
