# SPDX-License-Identifier: Apache-2.0
"""Places near a place: the best of them, and those that say what chance does there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity
from skymoor.types import Array

GOLDEN = 0.61803
"""Of a turn: directions that many steps apart fill the circle evenly."""


@dataclass(frozen=True)
class RefineOptions:
    """Simplex search (Nelder and Mead 1965) over position, heading and scale, once for each of `sizes`.

    Attributes:
        trials: places that each search may try.
        sizes: of the first steps, in units of
        steps_m, heading_deg, scale: which are east, north and up, in heading, and in the logarithm of the scale.
    """

    trials: int = 60
    sizes: tuple[float, ...] = (2.5, 1.0)
    steps_m: tuple[float, float, float] = (0.4, 0.4, 0.3)
    heading_deg: float = 0.6
    scale: float = 0.01


@dataclass(frozen=True)
class PerturbationOptions:
    """How many places around an answer, and how far from it, it is compared with."""

    count: int = 24
    min_m: float = 1.5
    max_m: float = 5.0


def refine_pose(
    start: Similarity, pivot_enu: Array, score: Callable[[Similarity], float], options: RefineOptions | None = None
) -> Similarity:
    """The place near `start` where `score` is highest.

    Args:
        start: ENU from level.
        pivot_enu: (3,) what heading and scale leave where it is: the middle of what is compared, so that the steps
            depend on each other as little as may be.
        score: of a place, the higher the better; need not be smooth.
        options: see there.
    """
    options = options or RefineOptions()
    unit = np.array([*options.steps_m, np.radians(options.heading_deg), options.scale])
    best = start
    for size in options.sizes:
        near = _Near(best, pivot_enu, size * unit)
        simplex = np.vstack([np.zeros(len(unit)), np.eye(len(unit))])
        limits = {"initial_simplex": simplex, "maxfev": options.trials, "xatol": 0.05, "fatol": 0.1}
        found = minimize(lambda x, near=near: -score(near.at(x)), simplex[0], method="Nelder-Mead", options=limits)
        best = near.at(found.x)
    return best


def perturbed(place: Similarity, options: PerturbationOptions | None = None) -> list[Similarity]:
    """The same place moved in plan, in all directions and by all lengths of the options."""
    options = options or PerturbationOptions()
    turns = 2 * np.pi * GOLDEN * np.arange(options.count)
    lengths = np.linspace(options.min_m, options.max_m, options.count)
    shifts = lengths[:, None] * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(options.count)])
    return [Similarity(1.0, np.eye(3), shift) @ place for shift in shifts]


@dataclass(frozen=True, eq=False)
class _Near:
    """Places around `start` by five numbers, whose units are `steps`."""

    start: Similarity
    pivot: Array
    steps: Array

    def at(self, x: Array) -> Similarity:
        """East, north, up, heading and scale away from the start."""
        move = x * self.steps
        scale, turn = float(np.exp(move[4])), Rotation.from_rotvec([0.0, 0.0, float(move[3])]).as_matrix()
        return Similarity(scale, turn, self.pivot + move[:3] - scale * turn @ self.pivot) @ self.start
