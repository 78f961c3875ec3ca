# SPDX-License-Identifier: Apache-2.0
"""How well the photos of a component agree with the airborne walls and plan when it has a certain pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.plan_view import PlanScores, plan_model
from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions
from skymoor.ground.walls.consensus import agreement_in_both, unusual_height
from skymoor.ground.walls.facade_pairs import FacadePair, pair_facades
from skymoor.ground.walls.facade_search import agreement_of_channels
from skymoor.ground.walls.facades import Facade, set_back
from skymoor.ground.walls.shifts import PoseEvidence, WallPictures
from skymoor.match.channels import make_channels
from skymoor.match.correlate import Target
from skymoor.types import Array, DepthMap


def plan_scores_of(
    maps_level: Sequence[DepthMap], airborne: AirborneWalls, options: GroundOptions, rng: np.random.Generator
) -> PlanScores | None:
    """The component in plan; None where it shows nothing steep."""
    try:
        return PlanScores(plan_model(maps_level, rng=rng), airborne.plan, options.plan.score)
    except DegenerateGeometry:
        return None


@dataclass(frozen=True, eq=False)
class PoseAgreement:
    """Agreement of a component, in approximate metres, with the airborne model at poses `enu_from_metric`.

    `maps` are its depth maps in that metric frame; `plan` is of its level frame, None where it shows nothing steep.
    """

    maps: Sequence[DepthMap]
    metric_from_level: Similarity
    plan: PlanScores | None
    airborne: AirborneWalls
    options: GroundOptions
    _targets: dict[tuple[float, ...], Target] = field(default_factory=dict)
    _set_back: dict[float, list[Facade]] = field(default_factory=dict)

    def on_walls(self, enu_from_metric: Similarity) -> tuple[float, float, int]:
        """Of all photos with all airborne walls that they should see: NCC, score, and the number of these walls."""
        pictures = self._pictures(enu_from_metric)
        return *agreement_of_channels([(ground, target.channels) for _, ground, target in pictures]), len(pictures)

    def in_plan(self, enu_from_metric: Similarity) -> float:
        """See `PlanHypothesis`; NaN where unknown."""
        return float("nan") if self.plan is None else self.plan.at(enu_from_metric @ self.metric_from_level)

    def of_all(self, enu_from_metric: Similarity) -> float:
        """In elevation and in plan together, less what is unusual, as `RefinedHypothesis.fit` counts them."""
        agreement = agreement_in_both(self.on_walls(enu_from_metric)[1], self.in_plan(enu_from_metric))
        return float(agreement - unusual_height(self.height_above_ground(enu_from_metric)))

    def of_shifts(self, enu_from_metric: Similarity) -> PoseEvidence:
        """What shifts of a pose are compared by."""
        height = self.height_above_ground(enu_from_metric)
        return PoseEvidence(
            lambda outwards: self._pictures(enu_from_metric, outwards),
            lambda east_north: self._shifted_in_plan(enu_from_metric, east_north),
            lambda up: unusual_height(height + up),
        )

    def height_above_ground(self, enu_from_metric: Similarity) -> float:
        """Of the cameras (median), in metres; NaN where the ground is not known."""
        centres = enu_from_metric.apply(np.array([depth_map.camera.centre for depth_map in self.maps]))
        above = centres[:, 2] - self.airborne.heights.ground_at(centres[:, :2])
        return float(np.nanmedian(above)) if np.isfinite(above).any() else float("nan")

    def _shifted_in_plan(self, enu_from_metric: Similarity, east_north: Array) -> Array:
        if self.plan is None:
            return np.full(len(east_north), np.nan)
        return self.plan.shifted(enu_from_metric @ self.metric_from_level, east_north)

    def _pictures(self, enu_from_metric: Similarity, outwards: float = 0.0) -> WallPictures:
        """Of all airborne walls that the photos should see, from the ground and from the air; as if the photos were so
        many metres further out before each wall.
        """
        airborne, options = self.airborne, self.options
        if outwards not in self._set_back:
            self._set_back[outwards] = [set_back(facade, outwards) for facade in airborne.facades]
        facades = self._set_back[outwards]
        pairs = pair_facades(facades, airborne.heights, self.maps, enu_from_metric, options.facade_pairs)
        sharp = options.search.sharp
        return [(pair.facade, make_channels(pair.ground, sharp), self._of_airborne(pair)) for pair in pairs]

    def _of_airborne(self, pair: FacadePair) -> Target:
        """The airborne side of a pair, which hardly depends on the pose, with its channels and their spectra."""
        key = (id(pair.airborne.rgb.base), *pair.offset_px.tolist(), *pair.airborne.mask.shape)
        if key not in self._targets:
            self._targets[key] = Target(make_channels(pair.airborne, self.options.search.blurred))
        return self._targets[key]
