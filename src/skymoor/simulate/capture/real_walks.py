# SPDX-License-Identifier: Apache-2.0
"""Walks and drives as people take them: in pieces, with gaps between them and quick turns at corners."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geometry import Intrinsics, Similarity
from skymoor.simulate.capture.aim import azimuth_deg, looking, standing_at
from skymoor.simulate.capture.carriers import EYE_M, STEP_M, Carrier, carrier_of, lens_of, motion_of
from skymoor.simulate.capture.footing import STEP_M as PLACE_M
from skymoor.simulate.capture.footing import circuit_round, clear_views
from skymoor.simulate.capture.tracks import FROM_WALL_M, Track, tracks_of
from skymoor.simulate.capture.walks import Walk, lifted
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import stream
from skymoor.simulate.plan import dates_of
from skymoor.simulate.world import World

Array = NDArray[np.float64]

PIECE = (5, 20)  # photos of a piece
GAP_M = (8.0, 20.0)  # between two pieces
LOST_M = 8.0  # of places that are not free, after which a new piece begins
WALL_SHARE = 0.12  # of the picture; trees and cars stand before the facades
LEAD_DEG, POLE_LEAD_DEG = 30.0, 35.0  # from straight at the facade, for a piece and for a camera on a pole
POLE_PITCH_DEG = (-18.0, -5.0)
POLES_APART_M = 0.4  # deviation of the heights of poles
KEPT_STEP = 6  # places between those that security cameras look at, where the group has none at its building


@dataclass(frozen=True, eq=False)
class Stop:
    """A place of a track where a photo may be taken: its number, that of the distance, and the piece it belongs to."""

    track: Track
    place: int
    column: int
    piece: int
    lead_deg: float

    @property
    def plan(self) -> Array:
        """East, north (2,)."""
        where: Array = self.track.plan[self.place, self.column]
        return where


@lru_cache(maxsize=8)
def real_walk_of(world: World, group: int) -> Walk:
    """The photos of a group under real conditions, in the order in which they are taken.

    Raises `InputError` when there is no building left, or when all tracks together have too few free places.
    """
    options, names = world.options, world.plan.walked
    if group >= len(names):
        raise InputError(f"groups = {options.groups}: the site has {len(names)} buildings to walk round; ask for fewer")
    building = next(b for b in world.plan.buildings if b.name == names[group])
    carrier, rng = carrier_of(options, group), stream(options.key, "real walk", group)
    lens, date = lens_of(options, carrier, rng), dates_of(options).ground
    scene, circuit = world.scene(date), circuit_round(building.outline_enu)
    taken: list[tuple[Stop, Similarity]] = []
    for stop in _stops(tracks_of(world, scene, carrier, building, date.sun), carrier, rng):
        pose = _aimed(world, scene, lens, carrier, stop, rng)
        if pose is not None:
            taken.append((stop, pose))
        if len(taken) == options.group_photos:
            break
    if len(taken) < options.group_photos:
        raise InputError(f"group_photos = {options.group_photos}: {len(taken)} have room on the site; ask for fewer")
    own = [stop.plan for stop, _ in taken if stop.track.building is building]
    apart = [np.linalg.norm(circuit.places([FROM_WALL_M[len(FROM_WALL_M) // 2]])[:, 0] - p, axis=1) for p in own]
    places = [int(distance.argmin()) for distance in apart] or list(range(0, len(circuit.wall), KEPT_STEP))
    return Walk(
        building,
        circuit,
        scene,
        lens,
        carrier.eye_m,
        tuple((place, float(FROM_WALL_M[len(FROM_WALL_M) // 2])) for place in places),
        tuple(pose for _, pose in taken),
        _numbered([stop.piece for stop, _ in taken]),
        tuple(motion_of(carrier, stop.track.travel[stop.place], rng) for stop, _ in taken),
    )


def _stops(tracks: Iterator[Track], carrier: Carrier, rng: np.random.Generator) -> Iterator[Stop]:
    """Places along tracks: pieces of 5 to 20, then a gap; corners are passed without a photo."""
    piece = 0
    for track in tracks:
        straight, free = track.straight, track.free
        k, m = 0, len(track.plan)
        while k < m:
            run = int(np.argmin(straight[k:])) if not straight[k:].all() else m - k
            if run == 0:
                k += 1
                continue
            piece += 1
            wanted = int(rng.integers(PIECE[0], PIECE[1] + 1))
            step = float(np.clip(run * PLACE_M / wanted, *STEP_M[carrier.kind])) / PLACE_M
            lead = float(rng.uniform(-LEAD_DEG, LEAD_DEG))
            last = k + min(run, round((wanted - 1) * step) + 1)
            columns = _columns(free[k:last], rng)
            for j in np.arange(k, last, step).astype(int):
                if columns[j - k] >= 0:
                    yield Stop(track, int(j), int(columns[j - k]), piece, lead)
            # A run that ends at a corner has its gap there.
            k = last if last == k + run else last + round(float(rng.uniform(*GAP_M)) / PLACE_M)


def _columns(free: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """Which distance (m,) from the facade is walked at, of those free (m, n): the one nearest to a wish, or -1."""
    n = free.shape[1]
    wish = rng.uniform(0, n - 1) + 0.15 * n * np.sin(np.arange(len(free)) * PLACE_M / 9 + rng.uniform(0, 6))
    cost = np.where(free, np.abs(np.arange(n) - wish[:, None]), np.inf)
    return np.where(free.any(axis=1), cost.argmin(axis=1), -1)


def _aimed(
    world: World, scene: Scene, lens: Intrinsics, carrier: Carrier, stop: Stop, rng: np.random.Generator
) -> Similarity | None:
    """The pose of one photo, or None where something stands before the lens or no facade is in view."""
    eye_m = carrier.eye_m + float(rng.normal(scale=POLES_APART_M if carrier.kind == "pole cameras" else 0.05))
    eye = lifted(world, stop.plan[None], float(np.clip(eye_m, *EYE_M[carrier.kind])))
    to_wall, travel = (float(azimuth_deg(x[stop.place])) for x in (stop.track.to_wall, stop.track.travel))
    if carrier.kind == "dash camera":
        left = (to_wall - travel + 180) % 360 - 180 < 0
        aims = [travel + (-1 if left else 1) * carrier.side_deg + float(rng.normal(scale=1.0))]
        pitch, roll = rng.normal((-1.0, 0.0), (1.0, 0.7))
    elif carrier.kind == "pole cameras":
        aims = [to_wall + float(rng.uniform(-POLE_LEAD_DEG, POLE_LEAD_DEG)), to_wall]
        pitch, roll = float(rng.uniform(*POLE_PITCH_DEG)), float(rng.normal(scale=1.0))
    else:
        aims = [to_wall + stop.lead_deg + float(rng.normal(scale=6.0)), to_wall]
        pitch, roll = rng.normal((5.0, 0.0), (3.0, 2.5))
    for aim in aims:
        turned = looking(aim, pitch, roll)
        if clear_views(scene, lens, eye, turned[None], wall_share=WALL_SHARE)[0]:
            return standing_at(eye[0], turned)
    return None


def _numbered(pieces: list[int]) -> tuple[int, ...]:
    """The same pieces, numbered from 0 without holes."""
    numbers = {piece: k for k, piece in enumerate(dict.fromkeys(pieces))}
    return tuple(numbers[piece] for piece in pieces)
