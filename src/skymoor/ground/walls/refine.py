# SPDX-License-Identifier: Apache-2.0
"""Local refinement of a pose, and perturbed poses that estimate the background score."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity
from skymoor.types import Array

GOLDEN = 0.61803
"""Golden ratio, of a full turn: directions at multiples of it fill the circle evenly."""


@dataclass(frozen=True)
class RefineOptions:
    """Simplex search (Nelder and Mead 1965) over position, vertical rotation and scale, for each of `sizes`.

    Attributes:
        trials: poses that each search may evaluate.
        sizes: of the first steps, in units of
        steps_m, rotation_deg, scale: which are east, north and up, in rotation, and in the logarithm of the scale.
    """

    trials: int = 60
    sizes: tuple[float, ...] = (2.5, 1.0)
    steps_m: tuple[float, float, float] = (0.4, 0.4, 0.3)
    rotation_deg: float = 0.6
    scale: float = 0.01


@dataclass(frozen=True)
class PerturbationOptions:
    """Number and distances of the perturbed poses around a hypothesis."""

    count: int = 16
    min_m: float = 1.5
    max_m: float = 5.0


def refine_pose(
    start: Similarity, pivot_enu: Array, score: Callable[[Similarity], float], options: RefineOptions | None = None
) -> Similarity:
    """The pose near `start` where `score` is highest.

    Args:
        start: ENU from level.
        pivot_enu: (3,) fixed point of rotation and scale: the centre of what is compared, so that the parameters are
            nearly independent.
        score: of a pose, the higher the better; need not be smooth.
        options: see there.
    """
    options = options or RefineOptions()
    unit = np.array([*options.steps_m, np.radians(options.rotation_deg), options.scale])
    best = start
    for size in options.sizes:
        near = _Near(best, pivot_enu, size * unit)
        simplex = np.vstack([np.zeros(len(unit)), np.eye(len(unit))])
        limits = {"initial_simplex": simplex, "maxfev": options.trials, "xatol": 0.05, "fatol": 0.1}
        found = minimize(lambda x, near=near: -score(near.at(x)), simplex[0], method="Nelder-Mead", options=limits)
        best = near.at(found.x)
    return best


def perturbed(pose: Similarity, options: PerturbationOptions | None = None) -> list[Similarity]:
    """The same pose shifted in plan, in all directions and by all lengths of the options."""
    options = options or PerturbationOptions()
    angles = 2 * np.pi * GOLDEN * np.arange(options.count)
    lengths = np.linspace(options.min_m, options.max_m, options.count)
    shifts = lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(options.count)])
    return [Similarity(1.0, np.eye(3), shift) @ pose for shift in shifts]


def turned(pose: Similarity, pivot_enu: Array, radians: float, scale: float = 1.0) -> Similarity:
    """The pose (ENU from level) rotated about the vertical through a point (3,), and enlarged from there."""
    rotation = Rotation.from_rotvec([0.0, 0.0, radians]).as_matrix()
    return Similarity(scale, rotation, pivot_enu - scale * rotation @ pivot_enu) @ pose


@dataclass(frozen=True, eq=False)
class _Near:
    """Poses around `start` by five numbers, whose units are `steps`."""

    start: Similarity
    pivot: Array
    steps: Array

    def at(self, x: Array) -> Similarity:
        """The pose that is this far from the start in east, north, up, rotation and scale."""
        step = x * self.steps
        moved = turned(self.start, self.pivot, float(step[3]), float(np.exp(step[4])))
        return Similarity(1.0, np.eye(3), step[:3]) @ moved
