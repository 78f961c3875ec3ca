# SPDX-License-Identifier: Apache-2.0
"""Ground photos onto the airborne model by what both share: geometry (the offline way of paper section 3.4).

Features in raw photos do not carry from the air to the ground. Walls do: both models have them, upright and flat, and
a wall's orthophoto looks alike from near and from far. Each ground wall is searched on each airborne wall; what the
walls of a component agree on is refined by dense matches; and the answer that explains best what all photos show of
all airborne walls is believed, if it is good enough and no other is nearly as good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skymoor.facade import (
    CounterpartOptions,
    Facade,
    FacadeOptions,
    Relief,
    WallOptions,
    check_sight,
    counterparts,
    facade_of,
    find_walls,
    relief_of,
    sight_of,
    similarity_between,
    surface_of,
)
from skymoor.geometry.similarity import Similarity
from skymoor.ground.matches import photo_matches, wall_matches
from skymoor.match import (
    CyclicOptions,
    DenseMatcher,
    FacadeSearchOptions,
    StructuralMatcher,
    agreement,
    search_shifts,
)
from skymoor.register import (
    Candidate,
    Guess,
    JudgeOptions,
    PoolOptions,
    RegisterOptions,
    independent_cells,
    judge_ground,
    pool_guesses,
    register,
)
from skymoor.types import Array, DepthMap, Matches3D, Progress, Registration, no_progress


@dataclass(frozen=True)
class GroundOptions:
    """How a ground component is laid on the airborne model.

    Attributes:
        pixel_m, ground_pixel_m: of the pictures of airborne and of ground walls.
        searched_walls: largest walls of the ground model that are searched on all airborne ones.
        min_scale, max_scale: metres per unit of the ground model that are searched. A levelled component has the
            cameras' height above the ground for its unit, but little ground is seen before a wall, so that the unit
            may be half or one and a half times of what it ought to be.
        max_blocked: share of the viewing rays of a guess that may cross buildings.
        max_angle_deg, max_gap_m: a ground wall and an airborne wall this close are matched densely.
        finalists: answers that are refined with all that the photos show.
        rounds: of that refinement, each from where the last one ended.
        walls, airborne_facades, ground_facades, search, pool, dense, cyclic, register, counterparts, judge: of the
            steps.
    """

    pixel_m: float = 0.2
    ground_pixel_m: float = 0.1
    searched_walls: int = 5
    min_scale: float = 0.6
    max_scale: float = 2.6
    max_blocked: float = 0.35
    max_angle_deg: float = 12.0
    max_gap_m: float = 1.5
    finalists: int = 4
    rounds: int = 2
    walls: WallOptions = field(default_factory=WallOptions)
    airborne_facades: FacadeOptions = field(default_factory=FacadeOptions)
    ground_facades: FacadeOptions = field(default_factory=lambda: FacadeOptions(margin_m=4.0, guess_margin_m=4.0))
    search: FacadeSearchOptions = field(default_factory=FacadeSearchOptions)
    pool: PoolOptions = field(default_factory=PoolOptions)
    dense: DenseMatcher = field(default_factory=StructuralMatcher)
    cyclic: CyclicOptions = field(default_factory=lambda: CyclicOptions(max_matches=1500))
    register: RegisterOptions = field(
        default_factory=lambda: RegisterOptions(inlier_m=0.5, correlation_m=3.0, tilt_sigma_deg=1.0)
    )
    counterparts: CounterpartOptions = field(default_factory=CounterpartOptions)
    judge: JudgeOptions = field(default_factory=JudgeOptions)


@dataclass(frozen=True, eq=False)
class AirborneWalls:
    """What ground components are laid on: walls with pictures, and heights seen from above, in ENU metres."""

    facades: tuple[Facade, ...]
    relief: Relief


def airborne_walls(
    maps_enu: Sequence[DepthMap],
    options: GroundOptions | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> AirborneWalls:
    """Prepare an airborne component, once for all ground components.

    Raises `DegenerateGeometry` when its depth maps show no surface from above.
    """
    options = options or GroundOptions()
    surface = surface_of(maps_enu)
    walls = find_walls(surface, options.walls, rng=rng)
    facades = []
    for done, wall in enumerate(walls):
        facades.append(facade_of(wall, maps_enu, options.pixel_m, options.airborne_facades))
        progress(done + 1, len(walls))
    return AirborneWalls(tuple(facades), relief_of(surface))


def register_ground(
    maps_level: Sequence[DepthMap],
    airborne: AirborneWalls,
    options: GroundOptions | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> Registration:
    """Where a levelled ground component stands, or why that is not known.

    Args:
        maps_level: depth maps of its photos, z up; a unit has about as many metres as `min_scale` and `max_scale` say.
        airborne: of `airborne_walls`.
        options: see there.
        rng: for walls and consensus; the same state gives the same answer.
        progress: counts the walls that are searched, then the answers that are refined.

    Returns:
        the registration. Its diagnostics hold the evidence: "score" and "second_score" of the best answer and of the
        best one elsewhere, "ncc", "walls_seen", "support" (walls that suggested the answer), "pooled_score" of these,
        "height_m", "blocked", "cells", and how much was searched: "walls", "guesses", "answers".
    """
    options = options or GroundOptions()
    # Sizes of walls are options in metres: a middling scale makes them so, nearly.
    metric_from_level = Similarity(float(np.sqrt(options.min_scale * options.max_scale)), np.eye(3), np.zeros(3))
    maps = [moved_map(depth_map, metric_from_level) for depth_map in maps_level]
    walls = find_walls(surface_of(maps, stride=2), options.walls, rng=rng)
    facades = [facade_of(wall, maps, options.ground_pixel_m, options.ground_facades) for wall in walls]
    work = _Work(maps, facades, airborne, options, rng)
    guesses = work.guesses(metric_from_level.scale, progress)
    answers = pool_guesses(guesses, work.probes, options.pool)
    candidates = []
    for done, answer in enumerate(answers):
        candidates.append(work.refined(answer))
        progress(done + 1, len(answers))
    candidates = sorted(candidates, key=lambda candidate: -candidate.score)
    finals = [work.finished(candidate) for candidate in candidates[: options.finalists]]
    candidates = sorted(finals + candidates[options.finalists :], key=lambda candidate: -candidate.score)
    found = judge_ground(candidates, work.inlier_cells(candidates), work.probes, options.judge)
    counts = {
        "walls": float(min(len(facades), options.searched_walls)),
        "guesses": float(len(guesses)),
        "answers": float(len(answers)),
    }
    enu_from_level = None if found.enu_from_level is None else found.enu_from_level @ metric_from_level
    return replace(found, enu_from_level=enu_from_level, diagnostics={**found.diagnostics, **counts})


def moved_map(depth_map: DepthMap, target_from_source: Similarity) -> DepthMap:
    """A depth map in another frame; depths and their uncertainty take the unit of that frame."""
    scale = np.float32(target_from_source.scale)
    return replace(
        depth_map,
        camera=depth_map.camera.moved(target_from_source),
        depth=depth_map.depth * scale,
        sigma=depth_map.sigma * scale,
    )


@dataclass(frozen=True, eq=False)
class _Work:
    """One ground component, in metres nearly, against one airborne one."""

    maps: Sequence[DepthMap]
    facades: Sequence[Facade]
    airborne: AirborneWalls
    options: GroundOptions
    rng: np.random.Generator

    @property
    def searched(self) -> Sequence[Facade]:
        return self.facades[: self.options.searched_walls]

    @property
    def probes(self) -> Array:
        """Cameras and corners of walls (n, 3): they say how far two answers are apart."""
        cameras = np.array([depth_map.camera.centre for depth_map in self.maps]).reshape(-1, 3)
        return np.concatenate([cameras, *(facade.wall.corners for facade in self.searched)])

    def guesses(self, unit_m: float, progress: Progress) -> list[Guess]:
        """Where single walls would put the model, without those that put it into the air or into buildings."""
        options, others = self.options, self.airborne.facades
        ratio = options.ground_pixel_m / options.pixel_m / unit_m
        shifts = search_shifts(
            [facade.raster for facade in self.searched],
            [facade.raster for facade in others],
            min_scale=options.min_scale * ratio,
            max_scale=options.max_scale * ratio,
            options=options.search,
            progress=progress,
        )
        sight = sight_of(self.maps, rays=24, rng=self.rng)
        found = []
        for shift in shifts[: options.pool.screened]:
            placed = similarity_between(self.searched[shift.a], others[shift.b], shift.matrix)
            check = check_sight(sight, placed, self.airborne.relief)
            stands = options.judge.min_height_m <= check.height_m <= options.judge.max_height_m
            if stands and check.outside <= 0.5 and check.blocked <= options.max_blocked:
                found.append(Guess(placed, shift.a, shift.b, shift.score))
        return found

    def refined(self, answer: Guess) -> Candidate:
        """The answer, or what the dense matches of its walls make of it if all photos agree better with that."""
        nothing = Registration(registered=False, reason="no dense matches", enu_from_level=None)
        start = self._candidate(answer, nothing, answer.enu_from_level)
        return max((start, self._round(start, all_photos=False)), key=lambda candidate: candidate.score)

    def finished(self, candidate: Candidate) -> Candidate:
        """The best of some rounds of dense matches that all photos take part in."""
        best = current = candidate
        for _ in range(self.options.rounds):
            current = self._round(current, all_photos=True)
            if not current.registration.registered:
                break
            if current.score > best.score or not best.registration.registered:
                best = current
        return best

    def inlier_cells(self, candidates: Sequence[Candidate]) -> int:
        """Places in which matches agree with the best candidate."""
        if not candidates or candidates[0].registration.inliers is None:
            return 0
        matches = self._matches(candidates[0].enu_from_level, all_photos=True)
        gaps = candidates[0].enu_from_level.apply(matches.xyz_level) - matches.xyz_enu
        near = np.linalg.norm(gaps, axis=1) <= self.options.register.inlier_m
        return independent_cells(matches.xyz_enu[near], self.options.judge.cell_m)

    def _round(self, candidate: Candidate, *, all_photos: bool) -> Candidate:
        matches = self._matches(candidate.enu_from_level, all_photos=all_photos)
        found = register(matches, self.options.pixel_m, self.options.register, rng=self.rng)
        placed = candidate.enu_from_level if found.enu_from_level is None else found.enu_from_level
        return self._candidate(candidate.answer, found, placed)

    def _matches(self, placed: Similarity, *, all_photos: bool) -> Matches3D:
        options = self.options
        found = wall_matches(
            self.facades,
            self.airborne.facades,
            placed,
            options.dense,
            options.cyclic,
            max_angle_deg=options.max_angle_deg,
            max_gap_m=options.max_gap_m,
            rng=self.rng,
        )
        if not all_photos:
            return found
        pairs = counterparts(self.airborne.facades, self.airborne.relief, self.maps, placed, options.counterparts)
        return Matches3D.joined([found, photo_matches(pairs, placed, options.dense, options.cyclic, rng=self.rng)])

    def _candidate(self, answer: Guess, found: Registration, placed: Similarity) -> Candidate:
        relief = self.airborne.relief
        pairs = counterparts(self.airborne.facades, relief, self.maps, placed, self.options.counterparts)
        ncc, score = agreement([(pair.near, pair.far) for pair in pairs], self.options.search)
        check = check_sight(sight_of(self.maps, rng=self.rng), placed, relief)
        return Candidate(answer, found, placed, score, ncc, len(pairs), check.height_m, check.blocked)
