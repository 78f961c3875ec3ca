# SPDX-License-Identifier: Apache-2.0
"""The correction of a registration by control: Bayesian, after data snooping has removed what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts load when they are first used

from skymoor.control.observations import PARAMETERS, Linear, Observations
from skymoor.geo import UNKNOWN_HEIGHT_SIGMA_M
from skymoor.types import Array

SIGNIFICANCE = 0.001
"""Probability of naming any right observation of a component wrong; divided among them (Bonferroni)."""
IDENTIFIABLE = 3
"""Surveyed positions from which on it can be told which one is wrong."""
ITERATIONS = 5
FREE_M2 = UNKNOWN_HEIGHT_SIGMA_M**2


@dataclass(frozen=True, eq=False)
class Snooped:
    """What data snooping found: blocks that are kept, and the test value and its limit of every block.

    Of a block that was removed the value is that at its removal.
    """

    kept: tuple[int, ...]
    tests: Array
    limits: Array


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Correction (8,) of the registration and its covariance (8, 8).

    `disagreement_m` (3,) is by how much control and reference differ, east, north and up, where that is more than the
    stated accuracies explain; None else.
    """

    correction: Array
    covariance: Array
    disagreement_m: Array | None = None


def free(prior: Array) -> Array:
    """A prior (8, 8) that knows nothing of the position."""
    return prior + np.diag([0.0] * 4 + [FREE_M2] * 3 + [0.0])


def snoop(observed: Observations, prior: Array) -> Snooped:
    """Data snooping (Baarda, A testing procedure for use in geodetic networks, 1968), in blocks (Teunissen 2006).

    The misclosures have the covariance S = A P A' + R. With u = S^-1 v, the hypothesis that the rows i of one
    observation are wrong has the test value u_i' (S^-1)_ii^-1 u_i, which is chi-square distributed with as many degrees
    of freedom as it has rows. The largest, in terms of its limit, is removed while it is beyond that; afterwards those
    that agree with the rest are taken back, since a large error makes its neighbours look wrong. The position is free:
    it is control that is compared with control, not with the reference.
    """
    linear, free_prior = observed.at(), free(prior)
    n = len(observed)
    limits = np.array([limit_of(block.stop - block.start, n) for block in linear.rows])
    kept, tests = list(range(n)), np.full(n, np.nan)
    while kept:
        found = _tests(linear.of(kept), free_prior)
        tests[kept] = found
        worst = kept[int(np.argmax(found / limits[kept]))]
        if tests[worst] <= limits[worst]:
            break
        kept.remove(worst)
    for k in sorted(set(range(n)) - set(kept), key=lambda k: tests[k] / limits[k]):
        together = sorted([*kept, k])
        again = _tests(linear.of(together), free_prior)
        if (again <= limits[together]).all():
            kept, tests[together] = together, again
    return Snooped(tuple(kept), tests, limits)


def limit_of(rows: int, count: int) -> float:
    """Largest test value of a right observation with so many rows, one of `count`."""
    return float(scipy.stats.chi2.isf(SIGNIFICANCE / max(count, 1), rows))


def _tests(linear: Linear, prior: Array) -> Array:
    """Test value of each block, see `snoop`."""
    inverse = np.linalg.inv(linear.design @ prior @ linear.design.T + linear.errors)
    u = inverse @ linear.misclosure
    return np.array([u[rows] @ np.linalg.solve(inverse[rows, rows], u[rows]) for rows in linear.rows])


def adjust(observed: Observations, prior: Array, kept: Sequence[int]) -> Adjusted:
    """The most probable correction and its covariance, by Gauss-Newton, with the prior (8, 8) of the registration.

    Where control and reference differ by more than both accuracies explain, and enough control agrees with itself, the
    reference is not what it was stated to be: then the position is that of control alone.
    """
    alone, covariance = _solved(observed, free(prior), kept)
    between = covariance[4:7, 4:7] + prior[4:7, 4:7]
    distance = float(alone[4:7] @ np.linalg.solve(between, alone[4:7]))
    if distance > scipy.stats.chi2.isf(SIGNIFICANCE, 3):
        return Adjusted(alone, covariance, np.where(np.diag(between) < FREE_M2 / 2, alone[4:7], np.nan))
    return Adjusted(*_solved(observed, prior, kept))


def _solved(observed: Observations, prior: Array, kept: Sequence[int]) -> tuple[Array, Array]:
    """Iterated update of a Gaussian prior (Bell and Cathey 1993, which is Gauss-Newton)."""
    step = np.zeros(PARAMETERS)
    for _ in range(ITERATIONS):
        linear = observed.at(step).of(kept)
        total = linear.design @ prior @ linear.design.T + linear.errors
        gain = np.linalg.solve(total, linear.design @ prior).T
        step = gain @ (linear.misclosure + linear.design @ step)
    # Joseph's form stays positive definite where the prior is a million times wider than the observations.
    rest = np.eye(PARAMETERS) - gain @ linear.design
    covariance = rest @ prior @ rest.T + gain @ linear.errors @ gain.T
    return step, (covariance + covariance.T) / 2
