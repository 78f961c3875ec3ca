# SPDX-License-Identifier: Apache-2.0
"""The agreement in plan of single similarities, as the search in plan scores them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.plan_view.search import PlanSearchOptions, Usual, all_maps, penalty, usual
from skymoor.ground.plan_view.target import PlanTarget
from skymoor.ground.plan_view.template import PlanModel
from skymoor.types import Array32

SCALE_STEP = 1.1  # scales this near have the same distribution of scores
SHIFTS = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
AZIMUTHS = np.radians(np.arange(0.0, 360.0, 60.0)).tolist()


@dataclass(frozen=True, eq=False)
class PlanScores:
    """Scores of a component on height steps; what is needed of a scale is computed once."""

    model: PlanModel
    target: PlanTarget
    options: PlanSearchOptions
    _usual: dict[int, Usual | None] = field(default_factory=dict)

    def at(self, enu_from_level: Similarity) -> float:
        """The score of a similarity, see `PlanHypothesis`; NaN where too little of the component is on the map."""
        scale, cell = enu_from_level.scale, self.target.grid.pixel_m
        typical = self._usual_at(scale)
        if typical is None:
            return float("nan")
        azimuth = float(np.arctan2(enu_from_level.rotation[1, 0], enu_from_level.rotation[0, 0]))
        normals, free = self.model.at(scale, azimuth, cell)
        centre = enu_from_level.apply(np.array([[*self.model.centre, 0.0]]))[:, :2]
        corner = np.round(self.target.grid.px_from_enu(centre)[0] - free.shape[0] / 2).astype(np.int64)
        corners = corner + SHIFTS
        ground = np.zeros(len(corners), np.float32)
        if self.target.colour is not None:
            cells = self.model.ground_at(scale, azimuth, cell)
            ground = typical.ground_score(cells.agreement(self.target.colour, corners))
        values = []
        for (u, v), of_ground in zip(corners.tolist(), ground.tolist(), strict=True):
            sums = self._sums(normals, free, u, v)
            if sums is not None:
                steps, inside = sums
                values.append(typical.steps_score(steps) - penalty(inside, scale, self.options) + of_ground)
        return float(max(values)) if values else float("nan")

    def _usual_at(self, scale: float) -> Usual | None:
        step = round(float(np.log(scale) / np.log(SCALE_STEP)))
        if step not in self._usual:
            near = SCALE_STEP**step
            maps = all_maps(self.model, self.target, near, AZIMUTHS, self.options)
            cells = [self.model.ground_at(near, azimuth, self.target.grid.pixel_m) for azimuth in AZIMUTHS]
            self._usual[step] = usual(maps, cells, self.target)
        return self._usual[step]

    def _sums(self, normals: Array32, free: Array32, u: int, v: int) -> tuple[float, float] | None:
        """Agreement with the steps and share of free space in houses, with the rasters' first pixel at (u, v)."""
        rows, columns = self.target.known.shape
        side = free.shape[0]
        v0, v1, u0, u1 = max(v, 0), min(v + side, rows), max(u, 0), min(u + side, columns)
        if v1 <= v0 or u1 <= u0:
            return None
        here, own = np.s_[v0:v1, u0:u1], np.s_[v0 - v : v1 - v, u0 - u : u1 - u]
        known, weight = self.target.known[here], np.hypot(*normals)
        free_known = float((free[own] * known).sum())
        least = self.options.on_map
        if free_known < least * free.sum() or (weight[own] * known).sum() < least * weight.sum():
            return None
        steps = sum(float((one[own] * step[here]).sum()) for one, step in zip(normals, self.target.steps, strict=True))
        houses = float((free[own] * self.target.raised[here]).sum())
        return steps, houses / max(free_known, 1.0)
