# SPDX-License-Identifier: Apache-2.0
"""Level ground for buildings on a hillside: cut into the slope on one side, filled up on the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.simulate.plan import Array, Building

FLAT_M = 1.2  # of level ground around the walls
BANK_M = 3.5  # from there to the natural ground


@dataclass(frozen=True)
class Terrace:
    """A level rectangle with embankments: its middle, the direction of its length, half its sides, and its height."""

    east: float
    north: float
    heading_deg: float
    half_m: tuple[float, float]
    up: float

    def apply(self, e: Array, n: Array, up: Array) -> None:
        """Change ground heights `up` at plan positions `e`, `n`, all (k,), in place."""
        reach = float(np.hypot(*self.half_m)) + FLAT_M + BANK_M
        near = np.flatnonzero((np.abs(e - self.east) < reach) & (np.abs(n - self.north) < reach))
        c, s = np.cos(np.radians(self.heading_deg)), np.sin(np.radians(self.heading_deg))
        away = np.stack([e[near] - self.east, n[near] - self.north])
        inner = np.abs(np.array([[c, s], [-s, c]]) @ away) - np.array(self.half_m)[:, None]
        distance = np.hypot(*np.maximum(inner, 0.0))
        t = np.clip(1 - (distance - FLAT_M) / BANK_M, 0, 1)
        share = t * t * (3 - 2 * t)
        up[near] += share * (self.up - up[near])


def terrace_of(building: Building, up: float) -> Terrace:
    """The terrace of a building, at height `up`."""
    low, high = np.min(building.outline, axis=0), np.max(building.outline, axis=0)
    half_m = tuple(float(x) for x in np.maximum(high, -low))
    return Terrace(building.east, building.north, building.heading_deg, (half_m[0], half_m[1]), up)
