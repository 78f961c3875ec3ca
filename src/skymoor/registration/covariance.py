# SPDX-License-Identifier: Apache-2.0
"""How well a registered model and its cameras are known, and by whose fault.

Two parts: what is *shared*, the reference's own error, which moves everything on it alike and which nobody can learn
from the images; and what is *relative* to the reference: the matches, the focal length and the reconstruction's shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist

from skymoor.errors import TooFewMatches
from skymoor.geometry import Similarity, point_covariance
from skymoor.geometry.adjust import sandwich_covariance
from skymoor.types import Array, Calibration, Reference, Registration

CORRELATION_LENGTHS = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)  # over which errors are alike, of the model's length
CORRELATED_FRACTIONS = (0.0, 0.03, 0.1, 0.3, 0.6, 0.9)  # of the variance that is so
MATCHES, LIKELIHOOD_MATCHES = 1000, 400  # of which the covariance and the likelihood are made, at most
MIN_MATCHES = 8
PLAN_RANK = 1e-6  # spread across a line in plan, of that along it, below which places are on the line
SMALLEST_VARIANCE_M2 = 1e-12  # a micrometre: residuals that are exactly zero have no likelihood
SHAPE_FACTOR = 2.0
"""By which standard deviations of camera centres exceed what independent pixel errors would make them. Errors of
pixels are not independent: docs/benchmarks.md has what was measured."""


@dataclass(frozen=True, eq=False)
class CameraAccuracy:
    """Covariances (n, 3, 3) of camera positions, m^2 in ENU: of the reference's error, and of all others."""

    shared: Array
    relative: Array

    @property
    def total(self) -> Array:
        """Of both."""
        return self.shared + self.relative


def matched_covariance(
    source: Array,
    target: Array,
    transform: Similarity,
    *,
    sigma_m: Array,
    tilt_sigma_deg: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, float]:
    """Covariance (7, 7) of a transform by matches whose errors are alike where they are near.

    How far, and which share of the errors, is not known. All pairs of both on a grid are tried, each has the
    likelihood of the residuals (see `_likelihoods`), and the covariances that follow from them are averaged by those.
    So an error that reaches over the whole model, and hides in its place, is believed to be possible.

    Args:
        source, target: (n, 3) each.
        transform: what the adjustment made of them.
        sigma_m: (3,) standard deviation of a match.
        tilt_sigma_deg: of the adjustment.
        rng: of the choice of matches, where there are many.

    Returns:
        the covariance, the point (3,) it refers to (see `refine_similarity`), and about how far errors reach, metres.

    Raises `TooFewMatches` for fewer than eight, and `DegenerateGeometry` where they leave the transform open.
    """
    n = len(source)
    if n < MIN_MATCHES:
        raise TooFewMatches(f"{n} matches do not say how sure they are, {MIN_MATCHES} are needed")
    some = np.sort(rng.permutation(n)[:MATCHES])
    source, target = source[some], target[some]
    placed = transform.apply(source)
    gap = cdist(placed, placed)
    reaches = [max(float(gap.max()) * ratio, 1.0) for ratio in CORRELATION_LENGTHS]
    few = np.sort(rng.permutation(len(some))[:LIKELIHOOD_MATCHES])
    residuals = (placed - target)[few]
    near = [_matern32(gap[np.ix_(few, few)], reach) for reach in reaches]
    kinds = _likelihoods([residuals[:, :2], residuals[:, 2:]], placed[few, :2], near)
    horizontal, vertical = _mean_covariances(gap, reaches, kinds, white=len(some) / n)
    covariance, centre = sandwich_covariance(
        source,
        target,
        transform,
        [horizontal, horizontal, vertical],
        sigma_m=sigma_m,
        tilt_sigma_deg=tilt_sigma_deg,
    )
    return covariance, centre, float(kinds[0].likely.sum(axis=1) @ reaches)


@dataclass(frozen=True, eq=False)
class _Kind:
    """Of errors along some axes: how likely each reach and share is, and the variance that it leaves, both (r, s)."""

    likely: Array
    variances: Array


def _matern32(gap: Array, reach: float) -> Array:
    """Correlation of errors at places so far apart: Matern's of smoothness 3/2."""
    scaled = np.sqrt(3.0) / reach * gap
    return np.asarray((1 + scaled) * np.exp(-scaled))


def _likelihoods(kinds: list[Array], plan: Array, near: list[Array]) -> list[_Kind]:
    """How likely reaches and shares are.

    Restricted likelihood (Patterson and Thompson, Biometrika 1971): the fit has taken a plane out of the residuals,
    and with it most of what reaches far; what is left is compared with what would be left of each.

    Args:
        kinds: residuals (n, axes) of each kind of error.
        plan: (n, 2) places.
        near: correlations (n, n), one per reach.
    """
    n = len(plan)
    design = _plane_basis(plan)
    free = n - design.shape[1]
    logs, variances = (np.zeros((len(kinds), len(near), len(CORRELATED_FRACTIONS))) for _ in range(2))
    for k, alike in enumerate(near):
        for m, share in enumerate(CORRELATED_FRACTIONS):
            root = cholesky(share * alike + (1 - share) * np.eye(n), lower=True)
            fit = solve_triangular(root, design, lower=True)
            normal = fit.T @ fit
            volume = np.log(np.diag(root)).sum() + np.linalg.slogdet(normal)[1] / 2
            for kind, residuals in enumerate(kinds):
                left = solve_triangular(root, residuals, lower=True)
                left = left - fit @ np.linalg.solve(normal, fit.T @ left)
                variance = max(float(np.mean(np.sum(left**2, axis=0))) / free, SMALLEST_VARIANCE_M2)
                logs[kind, k, m] = -residuals.shape[1] * (volume + free * np.log(variance) / 2)
                variances[kind, k, m] = variance
    likely = np.exp(logs - logs.max(axis=(1, 2), keepdims=True))
    likely /= likely.sum(axis=(1, 2), keepdims=True)
    return [_Kind(*pair) for pair in zip(likely, variances, strict=True)]


def _plane_basis(plan: Array) -> Array:
    """Orthonormal basis (n, rank) of the functions a + b x + c y at places (n, 2).

    Matches on a vertical wall are on one line in plan: b and c cannot be told apart there, and the rank is 2.
    """
    design = np.column_stack([np.ones(len(plan)), plan - plan.mean(axis=0)])
    design[:, 1:] /= max(float(np.abs(design[:, 1:]).max()), 1e-12)
    basis, sizes, _ = np.linalg.svd(design, full_matrices=False)
    return np.asarray(basis[:, sizes > PLAN_RANK * sizes[0]])


def _mean_covariances(gap: Array, reaches: list[float], kinds: list[_Kind], *, white: float) -> list[Array]:
    """Covariance (n, n) of the errors of each kind, averaged over all reaches and shares.

    A part of the matches stands for all of them, whose independent errors average out further: `white` is what that
    part of a variance counts.
    """
    shares = np.array(CORRELATED_FRACTIONS)
    weights = [kind.likely * kind.variances for kind in kinds]
    totals = [float((w * (1 - shares)).sum()) * white * np.eye(len(gap)) for w in weights]
    for k, reach in enumerate(reaches):
        alike = _matern32(gap, reach)
        for total, w in zip(totals, weights, strict=True):
            total += float((w[k] * shares).sum()) * alike
    return totals


def camera_accuracy(
    registration: Registration,
    centres_enu: Array,
    reference: Reference,
    calibration: Calibration | None,
    shape_enu: Array | None = None,
) -> CameraAccuracy:
    """Predicted accuracy of camera positions.

    A focal length that is wrong by one percent puts every camera one percent of its height too high.

    Args:
        registration: with a covariance.
        centres_enu: (n, 3) metres.
        reference: its covariance is shared.
        calibration: says how well the focal length is known; None where it does not matter.
        shape_enu: covariances (n, 3, 3) m^2 of the reconstruction's shape, where they are known.

    Raises `TooFewMatches` for a registration without covariance.
    """
    if registration.covariance is None or registration.centroid_enu is None:
        raise TooFewMatches("an unregistered model has no accuracy")
    centres = np.asarray(centres_enu, dtype=np.float64).reshape(-1, 3)
    relative = point_covariance(registration.covariance, registration.centroid_enu, centres)
    if calibration is not None:
        above = centres[:, 2] - registration.centroid_enu[2]
        relative[:, 2, 2] += (calibration.focal_sigma * above) ** 2
    if shape_enu is not None:
        relative = relative + SHAPE_FACTOR**2 * shape_enu
    return CameraAccuracy(np.broadcast_to(reference.covariance, relative.shape), relative)
