# SPDX-License-Identifier: Apache-2.0
"""The agreement in plan of single similarities, as the search in plan scores them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.plan_view.search import PlanSearchOptions, all_maps, penalty, standard
from skymoor.ground.plan_view.target import PlanTarget
from skymoor.ground.plan_view.template import PlanModel
from skymoor.types import Array32

SCALE_STEP = 1.1  # scales this near have the same distribution of scores
AZIMUTHS = np.radians(np.arange(0.0, 360.0, 60.0)).tolist()


@dataclass(frozen=True, eq=False)
class PlanScores:
    """Scores of a component on height steps; what is needed of a scale is computed once."""

    model: PlanModel
    target: PlanTarget
    options: PlanSearchOptions
    _standards: dict[int, tuple[float, float] | None] = field(default_factory=dict)

    def at(self, enu_from_level: Similarity) -> float:
        """The score of a similarity, see `PlanHypothesis`; NaN where too little of the component is on the map."""
        step = round(float(np.log(enu_from_level.scale) / np.log(SCALE_STEP)))
        if step not in self._standards:
            maps = all_maps(self.model, self.target, SCALE_STEP**step, AZIMUTHS, self.options)
            self._standards[step] = standard(maps)
        usual, scale = self._standards[step], enu_from_level.scale
        if usual is None:
            return float("nan")
        azimuth = float(np.arctan2(enu_from_level.rotation[1, 0], enu_from_level.rotation[0, 0]))
        normals, free = self.model.at(scale, azimuth, self.target.grid.pixel_m)
        centre = enu_from_level.apply(np.array([[*self.model.centre, 0.0]]))[:, :2]
        corner = self.target.grid.px_from_enu(centre)[0] - free.shape[0] / 2
        u, v = (round(float(x)) for x in corner)
        shifts = [(u + du, v + dv) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
        found = [one for one in (self._sums(normals, free, *shift) for shift in shifts) if one is not None]
        values = [(steps - usual[0]) / usual[1] - penalty(inside, scale, self.options) for steps, inside in found]
        return float(max(values)) if values else float("nan")

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
