# SPDX-License-Identifier: Apache-2.0
"""CE90 and LE90, the accuracy measures of mapping, to and from covariances in east, north, up."""

from __future__ import annotations

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import InputError

Array = NDArray[np.float64]

PROBABILITY = 0.9
# CE90 of a circular error and LE90, in standard deviations.
CE90_PER_SIGMA = float(np.sqrt(-2.0 * np.log(1.0 - PROBABILITY)))
LE90_PER_SIGMA = 1.6448536269514722  # quantile of the normal distribution at (1 + PROBABILITY) / 2
# Standard deviation of heights about which nothing is known: land is between -430 and 8850 m.
UNKNOWN_HEIGHT_SIGMA_M = 5000.0
LARGEST_M = 1e6  # of a CE90 or LE90: more is a mistake


UNKNOWN_ACCURACY: Array = np.full((3, 3), np.nan)
"""The covariance of a reference of which nobody says how accurate it is: what comes of it has no absolute accuracy."""


def covariance_from_ce90_le90(ce90_m: float, le90_m: float) -> Array:
    """Covariance (3, 3) in m^2 of a circular horizontal error of that CE90 and a vertical error of that LE90.

    Raises `InputError` when a figure is not a positive number of metres.
    """
    for name, value in (("ce90", ce90_m), ("le90", le90_m)):
        if not 0 < value < LARGEST_M:
            raise InputError(f"{name} = {value} must be a positive number of metres, below {LARGEST_M:.0f}")
    horizontal, vertical = (ce90_m / CE90_PER_SIGMA) ** 2, (le90_m / LE90_PER_SIGMA) ** 2
    return np.diag([horizontal, horizontal, vertical])


def ce90_m(covariance: ArrayLike) -> float:
    """Radius in metres that holds 90 % of the horizontal errors of a covariance (2, 2) or (3, 3) in m^2.

    NaN for `UNKNOWN_ACCURACY`. Exact for every error ellipse: the probability inside a circle is one smooth integral,
    solved for 90 %.
    """
    plan = np.asarray(covariance, dtype=np.float64)[:2, :2]
    if np.isnan(plan).all():
        return float("nan")
    minor, major = np.sqrt(np.maximum(np.linalg.eigvalsh((plan + plan.T) / 2.0), 0.0))
    if not np.isfinite(major):
        raise ValueError("the covariance is not finite")
    if major == 0:
        return 0.0
    ratio = float(minor / major)
    radius = scipy.optimize.brentq(
        lambda r: _share_within(r, ratio) - PROBABILITY, 0.9 * LE90_PER_SIGMA, 1.1 * CE90_PER_SIGMA, xtol=1e-12
    )
    return float(radius * major)


def le90_m(covariance: ArrayLike) -> float:
    """Height error in metres that 90 % of the errors of a covariance (3, 3) in m^2 stay below."""
    return LE90_PER_SIGMA * float(np.sqrt(np.asarray(covariance, dtype=np.float64)[2, 2]))


def mahalanobis(errors: ArrayLike, covariance: ArrayLike) -> Array:
    """Lengths (n,) of errors (n, 3) in metres, in standard deviations of a covariance (3, 3) in m^2.

    NaN for `UNKNOWN_ACCURACY`.
    """
    e = np.asarray(errors, dtype=np.float64).reshape(-1, 3)
    if np.isnan(covariance).all():
        return np.full(len(e), np.nan)
    root = np.linalg.cholesky(checked_covariance(covariance))
    lengths: Array = np.linalg.norm(np.linalg.solve(root, e.T), axis=0)
    return lengths


def checked_covariance(covariance: ArrayLike, *, name: str = "covariance") -> Array:
    """The covariance (3, 3) in m^2 as an exactly symmetric array.

    Raises `InputError`, which starts with `name`, when it is not a symmetric positive definite (3, 3) matrix.
    """
    try:
        matrix = np.asarray(covariance, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be 3 rows of 3 numbers in m^2, east-north-up") from None
    if matrix.shape != (3, 3):
        raise InputError(f"{name} must be 3 rows of 3 numbers in m^2, east-north-up, not of shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} must have finite numbers")
    if np.abs(matrix - matrix.T).max() > 1e-6 * np.abs(matrix).max():
        raise InputError(f"{name} must be symmetric: entry (i, j) equals entry (j, i)")
    symmetric: Array = (matrix + matrix.T) / 2.0
    if (np.diag(symmetric) <= 0).any():
        raise InputError(f"{name} must have positive variances on its diagonal, in m^2")
    if np.linalg.eigvalsh(symmetric)[0] <= 0:
        raise InputError(f"{name} must be positive definite: its correlations are larger than 1")
    return symmetric


def _share_within(radius: float, ratio: float) -> float:
    """Probability that an error with standard deviations 1 and `ratio` (at most 1) is shorter than `radius`.

    Integrates along the longer axis, x = radius sin(t), the share that stays inside the circle across it.
    """
    t = (np.arange(2048) + 0.5) * (np.pi / 2 / 2048)
    x, half_width = radius * np.sin(t), radius * np.cos(t)
    across = np.ones_like(t) if ratio == 0 else 1.0 - 2.0 * scipy.special.ndtr(-half_width / ratio)
    return float(np.pi * np.mean(np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi) * across * half_width))
