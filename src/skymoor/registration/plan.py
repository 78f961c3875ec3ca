# SPDX-License-Identifier: Apache-2.0
"""Position, azimuth and scale on the map, from what agrees in plan; no height of the reference is used.

A level model and a map are related in plan by a similarity of four parameters. Heights of an elevation model whose
unit, datum or age may be wrong have no influence on it. Where raised surfaces of an orthophoto lean away from the
satellite, their displacement is proportional to their height above ground (Kraus, Photogrammetry, 2007, on relief
displacement): two more parameters, estimated where they are significant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import ransac_similarity
from skymoor.types import Array, Mask

Complex = NDArray[np.complex128]

SIGMA_FLOOR_M = 0.05
TUKEY_CUT = 5.12
"""In standard deviations per axis: 95 % efficiency for two-dimensional Gaussian residuals."""
ROUNDS = 20
RAISED_M = 2.5
"""Height above ground from which a match counts as raised: it is displaced by lean, the others are not."""
LARGEST_LEAN = 1.0
MIN_RAISED = 30
LEAN_GAIN = 0.1
"""Share of the raised matches that must agree because of the lean and not without, lest chance be taken for one."""


@dataclass(frozen=True, eq=False)
class PlanFit:
    """A similarity in plan: position (east + i north) of a model point (x + i y) is `factor` times it plus `shift`.

    Attributes:
        factor: metres per level unit times exp(i azimuth).
        shift: metres, east + i north.
        lean: displacement in the map, metres per metre of height above ground, east + i north; 0 where there is none.
        weights: (n,) of the matches in the adjustment, 0 to 1.
        residuals: (n, 2) metres, model minus map, with the lean taken out.
        inliers: (n,), residuals up to `inlier_m`.
    """

    factor: complex
    shift: complex
    lean: complex
    weights: Array
    residuals: Array
    inliers: Mask
    inlier_m: float

    @property
    def scale(self) -> float:
        """Metres per level unit."""
        return abs(self.factor)

    @property
    def azimuth_rad(self) -> float:
        """Rotation from the level frame, counter-clockwise."""
        return float(np.angle(self.factor))

    def refitted(self, plan: Array, east_north: Array, above_ground_m: Array) -> PlanFit:
        """Adjusted again to points (n, 2) in metres that lie nearly where they belong."""
        p, q = _complex(plan), _complex(east_north)
        return _adjusted(p, q, np.nan_to_num(above_ground_m), (1 + 0j, 0j, self.lean), self.inlier_m)


def fit_plan(
    plan: Array, east_north: Array, above_ground_m: Array, *, inlier_m: float, rng: np.random.Generator
) -> PlanFit:
    """The similarity in plan that most matches agree on, adjusted robustly.

    Args:
        plan: (n, 2) of the matches in the level frame.
        east_north: (n, 2) metres on the map.
        above_ground_m: (n,) height of the model's points above its ground, NaN where unknown; for the lean.
        inlier_m: largest residual of an inlier.
        rng: draws samples.

    Raises `TooFewMatches` and `DegenerateGeometry` where the matches determine no similarity.
    """
    flat = np.zeros((len(plan), 1))
    consensus = ransac_similarity(np.hstack([plan, flat]), np.hstack([east_north, flat]), inlier_m=inlier_m, rng=rng)
    p, q = _complex(plan), _complex(east_north)
    start = consensus.transform.rotation[:2, 0] @ [1, 1j] * consensus.transform.scale
    shift = consensus.transform.translation[:2] @ [1, 1j]
    height = np.nan_to_num(above_ground_m)
    lean = _lean(q - start * p - shift, height, inlier_m, rng)
    return _adjusted(p, q, height, (complex(start), complex(shift), lean), inlier_m)


def _complex(pairs: Array) -> Complex:
    return np.asarray(pairs[:, 0] + 1j * pairs[:, 1])


def _adjusted(p: Complex, q: Complex, height: Array, start: tuple[complex, complex, complex], limit: float) -> PlanFit:
    """Iteratively reweighted least squares (Tukey's loss); the lean is adjusted where it is not zero."""
    columns = [p, np.ones_like(p)] + ([height.astype(np.complex128)] if start[2] else [])
    design, solution = np.column_stack(columns), np.array(start[: len(columns)])
    weights = (np.abs(q - design @ solution) <= limit).astype(np.float64)
    for _ in range(ROUNDS):
        if np.count_nonzero(weights) < len(columns) + 1:
            raise TooFewMatches(f"{np.count_nonzero(weights)} matches agree in plan")
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(design * root[:, None], q * root, rcond=None)[0]
        residuals = np.abs(q - design @ solution)
        # Median of a Rayleigh distribution in standard deviations per axis.
        sigma = max(float(np.median(residuals[residuals <= limit])) / 1.1774, SIGMA_FLOOR_M)
        weights = np.maximum(1 - (residuals / min(TUKEY_CUT * sigma, limit)) ** 2, 0.0) ** 2
    if abs(solution[0]) == 0:
        raise DegenerateGeometry("the matches coincide in plan")
    left = design @ solution - q
    lean = complex(solution[2]) if start[2] else 0j
    pairs = np.column_stack([left.real, left.imag])
    return PlanFit(complex(solution[0]), complex(solution[1]), lean, weights, pairs, np.abs(left) <= limit, limit)


def _lean(residuals: Complex, height: Array, limit: float, rng: np.random.Generator) -> complex:
    """Displacement per height above ground on which the raised matches agree; 0 without a clear gain over none."""
    raised = height > RAISED_M
    if np.count_nonzero(raised) < MIN_RAISED:
        return 0j
    off, up = residuals[raised], height[raised]
    trials = rng.permutation(len(off))[:300]
    candidates = off[trials] / up[trials]
    candidates = np.append(candidates[np.abs(candidates) <= LARGEST_LEAN], 0.0)
    agree = (np.abs(off - candidates[:, None] * up) <= limit).sum(axis=1)
    best = int(np.argmax(agree))
    gain = (agree[best] - agree[-1]) / len(off)
    return complex(candidates[best]) if gain >= LEAN_GAIN else 0j
