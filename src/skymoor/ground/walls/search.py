# SPDX-License-Identifier: Apache-2.0
"""The places where a ground component may stand on the airborne walls, best first, and whether to believe the best."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity
from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions, transformed_depth_map
from skymoor.ground.walls.consensus import RefinedHypothesis, WallHypothesis, pool_hypotheses
from skymoor.ground.walls.dense import photo_matches, wall_matches
from skymoor.ground.walls.facade_pairs import pair_facades
from skymoor.ground.walls.facade_search import agreement, search_facades
from skymoor.ground.walls.facades import Facade, facade_of, similarity_between
from skymoor.ground.walls.hypotheses import WallHypotheses
from skymoor.ground.walls.refine import perturbed, refine_pose
from skymoor.ground.walls.surface import surface_of
from skymoor.ground.walls.visibility import check_visibility, view_rays_of
from skymoor.ground.walls.walls import Wall, find_walls
from skymoor.registration import independent_cells, register, restated, with_covariance_of
from skymoor.types import Array, DepthMap, Matches3D, Progress, Registration, no_progress


def search_ground(
    maps_level: Sequence[DepthMap],
    airborne: AirborneWalls,
    options: GroundOptions | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> WallHypotheses:
    """Where a levelled ground component may stand.

    Args:
        maps_level: depth maps of its photos, z up; a unit has about as many metres as `min_scale` and `max_scale` say.
        airborne: of `airborne_walls`.
        options: see there.
        rng: for walls and consensus; the same state gives the same answer.
        progress: counts the walls that are searched, then the answers that are refined.

    Returns:
        the answers. The diagnostics of the registration that they are judged to be hold the evidence: "contrast" and
        "second_contrast" of the best answer and of the best one elsewhere, their "score" and "second_score", "ncc",
        "walls_seen", "support" (walls that suggested the answer), "pooled_score" of these, "height_m", "blocked",
        "cells", and how much was searched: "walls", "guesses", "answers".
    """
    options = options or GroundOptions()
    # Sizes of walls are options in metres: a middling scale makes them so, nearly.
    middling = Similarity(float(np.sqrt(options.min_scale * options.max_scale)), np.eye(3), np.zeros(3))
    work = _Work.of(maps_level, middling, airborne, options, rng)
    guesses = work.guesses(progress)
    answers = pool_hypotheses(guesses, work.probes, options.pool)
    candidates = []
    for done, answer in enumerate(answers):
        candidates.append(work.refined(answer))
        progress(done + 1, len(answers))
    candidates = sorted(candidates, key=lambda candidate: -candidate.score)
    finals = _finished(candidates[: options.finalists], work)
    ranked = sorted(finals, key=lambda candidate: -candidate.contrast)
    counts = {"walls": len(work.searched), "guesses": len(guesses), "answers": len(answers)}
    probes = middling.inverse().apply(work.probes)
    return WallHypotheses(tuple(ranked), probes, {name: float(n) for name, n in counts.items()}, options.acceptance)


def _finished(candidates: Sequence[RefinedHypothesis], work: _Work) -> list[RefinedHypothesis]:
    """The candidates refined with all that the photos show, on walls of their own scale."""
    rescaled: dict[int, _Work] = {}
    found = []
    for candidate in candidates:
        # Scales this near find the same walls.
        step = round(np.log(candidate.enu_from_level.scale) / np.log(1.1))
        if step and step not in rescaled:
            rescaled[step] = work.rescaled(1.1**step)
        own = rescaled[step] if step else work
        found.append(own.levelled(own.settled(own.tested(own.polished(own.finished(own.adopted(candidate, work)))))))
    return found


@dataclass(frozen=True, eq=False)
class _Work:
    """One ground component, in metres nearly, against one airborne one."""

    maps_level: Sequence[DepthMap]
    metric_from_level: Similarity
    maps: Sequence[DepthMap]
    facades: Sequence[Facade]
    airborne: AirborneWalls
    options: GroundOptions
    rng: np.random.Generator

    @classmethod
    def of(
        cls,
        maps_level: Sequence[DepthMap],
        metric_from_level: Similarity,
        airborne: AirborneWalls,
        options: GroundOptions,
        rng: np.random.Generator,
    ) -> _Work:
        maps = [transformed_depth_map(depth_map, metric_from_level) for depth_map in maps_level]
        walls = find_walls(surface_of(maps, stride=2), options.walls, rng=rng)
        facades = [facade_of(wall, maps, options.ground_pixel_m, options.ground_facades) for wall in walls]
        return cls(maps_level, metric_from_level, maps, facades, airborne, options, rng)

    def rescaled(self, factor: float) -> _Work:
        """The same component, `factor` times as large, with the walls that it shows at that size."""
        larger = Similarity(factor, np.eye(3), np.zeros(3)) @ self.metric_from_level
        return self.of(self.maps_level, larger, self.airborne, self.options, self.rng)

    def adopted(self, candidate: RefinedHypothesis, former: _Work) -> RefinedHypothesis:
        """A candidate of the component at another size."""
        if former is self:
            return candidate
        former_from_own = former.metric_from_level @ self.metric_from_level.inverse()
        return replace(candidate, enu_from_level=candidate.enu_from_level @ former_from_own)

    def levelled(self, candidate: RefinedHypothesis) -> RefinedHypothesis:
        """The candidate as it is told outside: from the level frame."""
        enu_from_level = candidate.enu_from_level @ self.metric_from_level
        found = candidate.registration
        if found.enu_from_level is not None:
            found = replace(found, enu_from_level=enu_from_level)
        return replace(candidate, enu_from_level=enu_from_level, registration=found)

    @property
    def searched(self) -> Sequence[Facade]:
        return self.facades[: self.options.searched_walls]

    @property
    def _solid(self) -> list[Wall]:
        return [facade.wall for facade in self.airborne.facades]

    @property
    def probes(self) -> Array:
        """Cameras and corners of walls (n, 3): they say how far two answers are apart."""
        cameras = np.array([depth_map.camera.centre for depth_map in self.maps]).reshape(-1, 3)
        return np.concatenate([cameras, *(facade.wall.corners for facade in self.searched)])

    def guesses(self, progress: Progress) -> list[WallHypothesis]:
        """Where single walls would put the model, without those that put it into the air or into buildings."""
        options, others = self.options, self.airborne.facades
        ratio = options.ground_pixel_m / options.pixel_m / self.metric_from_level.scale
        shifts = search_facades(
            [facade.raster for facade in self.searched],
            [facade.raster for facade in others],
            min_scale=options.min_scale * ratio,
            max_scale=options.max_scale * ratio,
            options=options.search,
            progress=progress,
        )
        sight = view_rays_of(self.maps, rays=24, rng=self.rng)
        found = []
        for shift in shifts[: options.pool.screened]:
            placed = similarity_between(self.searched[shift.a], others[shift.b], shift.matrix)
            check = check_visibility(sight, placed, self.airborne.relief, self._solid)
            stands = options.acceptance.min_height_m <= check.height_m <= options.acceptance.max_height_m
            if stands and check.outside <= 0.5 and check.blocked <= options.max_blocked:
                found.append(WallHypothesis(placed, shift.a, shift.b, shift.score))
        return found

    def refined(self, answer: WallHypothesis) -> RefinedHypothesis:
        """The answer, or what the dense matches of its walls make of it if all photos agree better with that."""
        nothing = Registration(registered=False, reason="no dense matches", enu_from_level=None)
        start = self._candidate(answer, nothing, answer.enu_from_level, cells=0)
        return max((start, self._round(start, all_photos=False)), key=lambda candidate: candidate.score)

    def finished(self, candidate: RefinedHypothesis) -> RefinedHypothesis:
        """The best of some rounds of dense matches that all photos take part in."""
        best = current = candidate
        for _ in range(self.options.rounds):
            current = self._round(current, all_photos=True)
            if not current.registration.registered:
                break
            if current.score > best.score or not best.registration.registered:
                best = current
        return best

    def polished(self, candidate: RefinedHypothesis) -> RefinedHypothesis:
        """Moved to where all photos together agree best with all walls.

        Matches pull each photo's picture of a wall towards the wall, one by one; where walls repeat themselves, or only
        one is large, that leaves the whole model a little aside. Here it is moved as a whole.
        """
        if not candidate.registration.registered:
            return candidate
        start = candidate.enu_from_level
        pivot = start.apply(view_rays_of(self.maps, rng=self.rng).ends.reshape(-1, 3)).mean(axis=0)
        best = refine_pose(start, pivot, lambda place: self._agreement(place)[1], self.options.refine)
        return self._candidate(candidate.answer, candidate.registration, best, candidate.cells)

    def tested(self, candidate: RefinedHypothesis) -> RefinedHypothesis:
        """The candidate with how much better all photos agree with the walls there than a few metres aside."""
        places = perturbed(candidate.enu_from_level, self.options.perturbation)
        return replace(candidate, perturbed_scores=tuple(self._agreement(place)[1] for place in places))

    def settled(self, candidate: RefinedHypothesis) -> RefinedHypothesis:
        """The candidate as its matches fit it best; what says whether it is believed stays.

        The highest agreement is at the right place to a few decimetres; from there matches are the more exact.
        """
        current = candidate
        for _ in range(self.options.rounds):
            current = self._round(current, all_photos=True, with_covariance=True)
            if not current.registration.registered or current.score < self.options.min_kept * candidate.score:
                return self._as_it_is(candidate)
        return replace(
            candidate,
            enu_from_level=current.enu_from_level,
            registration=current.registration,
            height_m=current.height_m,
            blocked=current.blocked,
            cells=current.cells,
        )

    def _as_it_is(self, candidate: RefinedHypothesis) -> RefinedHypothesis:
        """The candidate where it is, with what matches say of that."""
        matches, placed = self._matches(candidate.enu_from_level, all_photos=True), candidate.enu_from_level
        found = restated(candidate.registration, placed, matches, self.options.register.inlier_m)
        with suppress(TooFewMatches, DegenerateGeometry):
            found = with_covariance_of(found, matches, self.options.register, rng=self.rng)
        cells = independent_cells(matches.xyz_enu[found.inliers], self.options.acceptance.cell_m)
        return replace(candidate, registration=found, cells=cells)

    def _round(
        self, candidate: RefinedHypothesis, *, all_photos: bool, with_covariance: bool = False
    ) -> RefinedHypothesis:
        matches = self._matches(candidate.enu_from_level, all_photos=all_photos)
        found = register(
            matches, self.options.pixel_m, self.options.register, rng=self.rng, with_covariance=with_covariance
        )
        placed = candidate.enu_from_level if found.enu_from_level is None else found.enu_from_level
        near = matches.xyz_enu[found.inliers] if found.inliers is not None else matches.xyz_enu[:0]
        cells = independent_cells(near, self.options.acceptance.cell_m)
        return self._candidate(candidate.answer, found, placed, cells)

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
        pairs = pair_facades(self.airborne.facades, self.airborne.relief, self.maps, placed, options.facade_pairs)
        return Matches3D.joined([found, photo_matches(pairs, placed, options.dense, options.cyclic, rng=self.rng)])

    def _candidate(
        self, answer: WallHypothesis, found: Registration, placed: Similarity, cells: int
    ) -> RefinedHypothesis:
        ncc, score, walls_seen = self._agreement(placed)
        check = check_visibility(view_rays_of(self.maps, rng=self.rng), placed, self.airborne.relief, self._solid)
        return RefinedHypothesis(answer, found, placed, score, ncc, walls_seen, check.height_m, check.blocked, cells)

    def _agreement(self, placed: Similarity) -> tuple[float, float, int]:
        """Of all photos with all airborne walls that they should see: ncc, score, and how many walls these are."""
        pairs = pair_facades(self.airborne.facades, self.airborne.relief, self.maps, placed, self.options.facade_pairs)
        return *agreement([(pair.ground, pair.airborne) for pair in pairs], self.options.search), len(pairs)
