# SPDX-License-Identifier: Apache-2.0
"""One ground component against the airborne walls: hypotheses, their refinement, and their scores."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity
from skymoor.ground.plan_view import search_plan
from skymoor.ground.surface import surface_of
from skymoor.ground.wall_planes import Wall, find_walls
from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions, transformed_depth_map
from skymoor.ground.walls.consensus import RefinedHypothesis
from skymoor.ground.walls.dense import photo_matches, wall_matches
from skymoor.ground.walls.facade_pairs import pair_facades
from skymoor.ground.walls.facade_search import search_facades
from skymoor.ground.walls.facades import Facade, facade_of, similarity_between
from skymoor.ground.walls.key_points import agreeing_cells
from skymoor.ground.walls.pool import WallHypothesis
from skymoor.ground.walls.pose_agreement import PoseAgreement, plan_scores_of
from skymoor.ground.walls.refine import RefineOptions, perturbed, refine_pose, turned
from skymoor.ground.walls.shifts import best_shift
from skymoor.ground.walls.visibility import ViewRays, check_visibility, view_rays_of
from skymoor.registration import independent_cells, register, restated, with_covariance_of
from skymoor.types import Array, DepthMap, Matches3D, Progress, Registration

HEIGHTS_M = (1.0, 1.7, 2.4, 3.2, 4.2, 5.5)  # of cameras above the ground, tried; the refinement closes the gaps

AHEAD = 4.0  # level units, which are camera heights: as far as walls usually are


def view_probes(maps: Sequence[DepthMap]) -> Array:
    """Points (2 n, 3) by which places and views of photos are compared: cameras, and points `AHEAD` before each."""
    cameras = [one.camera for one in maps]
    centres = np.array([camera.centre for camera in cameras]).reshape(-1, 3)
    axes = np.array([camera.cam_from_world.rotation[2] for camera in cameras]).reshape(-1, 3)
    return np.concatenate([centres, centres + AHEAD * axes])


@dataclass(frozen=True, eq=False)
class ComponentSearch:
    """One ground component, in approximate metres, against the airborne walls.

    Within the search `enu_from_level` of a hypothesis is from this metric frame, until `in_level_frame`.
    """

    maps_level: Sequence[DepthMap]
    metric_from_level: Similarity
    maps: Sequence[DepthMap]
    facades: Sequence[Facade]
    rays: ViewRays
    airborne: AirborneWalls
    options: GroundOptions
    rng: np.random.Generator
    agreement: PoseAgreement

    @classmethod
    def of(
        cls,
        maps_level: Sequence[DepthMap],
        metric_from_level: Similarity,
        airborne: AirborneWalls,
        options: GroundOptions,
        rng: np.random.Generator,
    ) -> ComponentSearch:
        maps = [transformed_depth_map(depth_map, metric_from_level) for depth_map in maps_level]
        walls = find_walls(surface_of(maps, stride=2), options.walls, rng=rng)
        facades = [facade_of(wall, maps, options.ground_pixel_m, options.ground_facades) for wall in walls]
        plan = plan_scores_of(maps_level, airborne, options, rng)
        rays = view_rays_of(maps, rng=rng)
        agreement = PoseAgreement(maps, metric_from_level, plan, airborne, options)
        return cls(maps_level, metric_from_level, maps, facades, rays, airborne, options, rng, agreement)

    def rescaled(self, factor: float) -> ComponentSearch:
        """The same component, `factor` times as large, with the walls that are found at that size."""
        larger = Similarity(factor, np.eye(3), np.zeros(3)) @ self.metric_from_level
        return self.of(self.maps_level, larger, self.airborne, self.options, self.rng)

    def taken_from(self, other: ComponentSearch, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """A hypothesis of the component at another size."""
        if other is self:
            return hypothesis
        other_from_own = other.metric_from_level @ self.metric_from_level.inverse()
        return replace(hypothesis, enu_from_level=hypothesis.enu_from_level @ other_from_own)

    def in_level_frame(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """The hypothesis for callers: from the level frame."""
        enu_from_level = hypothesis.enu_from_level @ self.metric_from_level
        found = hypothesis.registration
        if found.enu_from_level is not None:
            found = replace(found, enu_from_level=enu_from_level)
        return replace(hypothesis, enu_from_level=enu_from_level, registration=found)

    @property
    def searched(self) -> Sequence[Facade]:
        return self.facades[: self.options.searched_walls]

    @property
    def _airborne_walls(self) -> list[Wall]:
        return [facade.wall for facade in self.airborne.facades]

    @property
    def probes(self) -> Array:
        """Cameras and corners of walls (n, 3), by which distances of hypotheses are measured."""
        cameras = np.array([depth_map.camera.centre for depth_map in self.maps]).reshape(-1, 3)
        return np.concatenate([cameras, *(facade.wall.corners for facade in self.searched)])

    def wall_hypotheses(self, progress: Progress) -> list[WallHypothesis]:
        """Hypotheses from single walls, without those that put cameras into the air or into buildings."""
        options, others = self.options, self.airborne.facades
        ratio = options.ground_pixel_m / options.pixel_m / self.metric_from_level.scale
        found = search_facades(
            [facade.raster for facade in self.searched],
            [facade.raster for facade in others],
            min_scale=options.min_scale * ratio,
            max_scale=options.max_scale * ratio,
            options=options.search,
            progress=progress,
        )
        possible = []
        for one in found[: options.pool.screened]:
            enu_from_metric = similarity_between(self.searched[one.a], others[one.b], one.matrix)
            check = check_visibility(self.rays, enu_from_metric, self.airborne.heights, self._airborne_walls)
            on_ground = options.acceptance.min_height_m <= check.height_m <= options.acceptance.max_height_m
            if on_ground and check.outside <= 0.5 and check.blocked <= options.max_blocked:
                possible.append(WallHypothesis(enu_from_metric, one.a, one.b, one.score))
        return possible

    def plan_hypotheses(self, progress: Progress) -> list[RefinedHypothesis]:
        """Hypotheses of the search in plan at that camera height with which all photos agree best, best first."""
        nothing = Registration(registered=False, reason="no dense matches", enu_from_level=None)
        plan = self.agreement.plan
        if plan is None:
            return []
        limits = replace(self.options.plan, min_scale=self.options.min_scale, max_scale=self.options.max_scale)
        found = []
        for one in search_plan(plan.model, plan.target, limits, progress=progress):
            flat = one.enu_from_level @ self.metric_from_level.inverse()
            trials = [self._standing(flat, height) for height in HEIGHTS_M]
            best = max(trials, key=lambda trial: self.agreement.on_walls(trial)[1])
            found.append(self._scored(WallHypothesis(best, -1, -1, one.score, 0), nothing, best, cells=0))
        return sorted(found, key=lambda hypothesis: -hypothesis.score)

    def _standing(self, enu_from_metric: Similarity, height_m: float) -> Similarity:
        """The similarity raised so that the cameras are so high above the ground (median)."""
        gap = np.nan_to_num(self.agreement.height_above_ground(enu_from_metric))
        return Similarity(1.0, np.eye(3), np.array([0.0, 0.0, height_m - gap])) @ enu_from_metric

    def refined_by_walls(self, origin: WallHypothesis) -> RefinedHypothesis:
        """The hypothesis, or its fit to dense matches of the walls if all photos agree better with that."""
        nothing = Registration(registered=False, reason="no dense matches", enu_from_level=None)
        start = self._scored(origin, nothing, origin.enu_from_level, cells=0)
        return max((start, self._fitted(start, all_photos=False)), key=lambda hypothesis: hypothesis.score)

    def refined_by_photos(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """The best of some rounds of dense matches of all photos."""
        best = current = hypothesis
        for _ in range(self.options.rounds):
            current = self._fitted(current, all_photos=True)
            if not current.registration.registered:
                break
            if current.score > best.score or not best.registration.registered:
                best = current
        return best

    def refined_as_a_whole(self, hypothesis: RefinedHypothesis, options: RefineOptions) -> RefinedHypothesis:
        """Maximise the agreement of all photos with all walls, and in plan.

        Matches align the view of each photo with a wall, one by one; where walls repeat themselves, or only one is
        large, that leaves an offset of the whole model. Here the model is moved as a whole.
        """
        start = hypothesis.enu_from_level
        pivot = start.apply(self.rays.ends.reshape(-1, 3)).mean(axis=0)
        best = refine_pose(start, pivot, self.agreement.of_all, options)
        return self._scored(hypothesis.origin, hypothesis.registration, best, hypothesis.cells)

    def shifted(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """The hypothesis at the best shift within a few metres and at a few azimuths, if all agrees better there."""
        pivot = hypothesis.enu_from_level.apply(self.rays.ends.reshape(-1, 3)).mean(axis=0)
        trials = [hypothesis]
        for degrees in self.options.rotations_deg:
            start = turned(hypothesis.enu_from_level, pivot, np.radians(degrees))
            moved = Similarity(1.0, np.eye(3), best_shift(self.agreement.of_shifts(start), self.options.shifts)) @ start
            trials.append(self._scored(hypothesis.origin, hypothesis.registration, moved, hypothesis.cells))
        return max(trials, key=lambda one: one.fit)

    def with_background(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """The hypothesis with the scores of perturbed positions around it."""
        trials = perturbed(hypothesis.enu_from_level, self.options.perturbation)
        return replace(hypothesis, perturbed_scores=tuple(self.agreement.on_walls(trial)[1] for trial in trials))

    def with_key_points(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """The hypothesis with the key points of walls that agree there; as it is without a matcher of these."""
        options, airborne = self.options, self.airborne
        if options.key_points is None:
            return hypothesis
        pose = hypothesis.enu_from_level
        pairs = pair_facades(airborne.facades, airborne.heights, self.maps, pose, options.facade_pairs)
        return replace(hypothesis, key_point_cells=agreeing_cells(pairs, options.key_points))

    def fitted_to_matches(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """Refine the pose by its matches; keep the scores on which acceptance is decided.

        The highest agreement is within a few decimetres of the right position; from there matches are more exact.
        """
        current = hypothesis
        for _ in range(self.options.rounds):
            current = self._fitted(current, all_photos=True, with_covariance=True)
            if not current.registration.registered or current.score < self.options.min_kept * hypothesis.score:
                return self._not_fitted(hypothesis)
        return replace(
            hypothesis,
            enu_from_level=current.enu_from_level,
            registration=current.registration,
            height_m=current.height_m,
            blocked=current.blocked,
            cells=current.cells,
        )

    def _not_fitted(self, hypothesis: RefinedHypothesis) -> RefinedHypothesis:
        """The hypothesis where it is, with the inliers and the covariance of its matches there."""
        matches, enu_from_metric = self._matches(hypothesis.enu_from_level, all_photos=True), hypothesis.enu_from_level
        found = restated(hypothesis.registration, enu_from_metric, matches, self.options.register.inlier_m)
        with suppress(TooFewMatches, DegenerateGeometry):
            found = with_covariance_of(found, matches, self.options.register, rng=self.rng)
        cells = independent_cells(matches.xyz_enu[found.inliers], self.options.acceptance.cell_m)
        return replace(hypothesis, registration=found, cells=cells)

    def _fitted(
        self, hypothesis: RefinedHypothesis, *, all_photos: bool, with_covariance: bool = False
    ) -> RefinedHypothesis:
        """The hypothesis registered by its matches, and scored."""
        matches = self._matches(hypothesis.enu_from_level, all_photos=all_photos)
        found = register(
            matches, self.options.pixel_m, self.options.register, rng=self.rng, with_covariance=with_covariance
        )
        enu_from_metric = hypothesis.enu_from_level if found.enu_from_level is None else found.enu_from_level
        inliers = matches.xyz_enu[found.inliers] if found.inliers is not None else matches.xyz_enu[:0]
        cells = independent_cells(inliers, self.options.acceptance.cell_m)
        return self._scored(hypothesis.origin, found, enu_from_metric, cells)

    def _matches(self, enu_from_metric: Similarity, *, all_photos: bool) -> Matches3D:
        options, airborne = self.options, self.airborne
        found = wall_matches(
            self.facades,
            airborne.facades,
            enu_from_metric,
            options.dense,
            options.cyclic,
            max_angle_deg=options.max_angle_deg,
            max_gap_m=options.max_gap_m,
            rng=self.rng,
        )
        if not all_photos:
            return found
        pairs = pair_facades(airborne.facades, airborne.heights, self.maps, enu_from_metric, options.facade_pairs)
        of_photos = photo_matches(pairs, enu_from_metric, options.dense, options.cyclic, rng=self.rng)
        return Matches3D.joined([found, of_photos])

    def _scored(
        self, origin: WallHypothesis, found: Registration, enu_from_metric: Similarity, cells: int
    ) -> RefinedHypothesis:
        ncc, score, walls_seen = self.agreement.on_walls(enu_from_metric)
        check = check_visibility(self.rays, enu_from_metric, self.airborne.heights, self._airborne_walls)
        visible, in_plan = (walls_seen, check.height_m, check.blocked), self.agreement.in_plan(enu_from_metric)
        return RefinedHypothesis(origin, found, enu_from_metric, score, ncc, *visible, cells, plan_score=in_plan)
