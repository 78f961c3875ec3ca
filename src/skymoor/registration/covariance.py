# SPDX-License-Identifier: Apache-2.0
"""Error budget of camera positions: shared (reference) and relative (matches, calibration, structure from motion).

The *shared* part is the reference's own absolute error, which is common to all positions and not observable in the
images. The *relative* part is the error with respect to the reference: of matches, focal length and model shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from skymoor.errors import TooFewMatches
from skymoor.geometry import Similarity, similarity_jacobian
from skymoor.geometry.adjust import sandwich_covariance
from skymoor.types import Array, Calibration, Reference, Registration

CORRELATION_LENGTHS = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)  # tried, as shares of the model's extent
CORRELATED_FRACTIONS = (0.0, 0.03, 0.1, 0.3, 0.6, 0.9)  # of the variance, tried
MATCHES, LIKELIHOOD_MATCHES = 1000, 400  # at most used for the covariance and for the likelihood
MIN_MATCHES = 8
PLAN_RANK = 1e-6  # ratio of singular values below which plan positions are collinear
SMALLEST_VARIANCE_M2 = 1e-12  # a micrometre: residuals that are exactly zero have no likelihood
SHAPE_FACTOR = 2.0
"""Factor on the formal standard deviations of camera centres: errors of observations are not independent, as the
formal covariance assumes. docs/benchmarks.md has the measurements."""


@dataclass(frozen=True, eq=False)
class CameraAccuracy:
    """Covariances (n, 3, 3) of camera positions, m^2 in ENU: of the reference's error, and of all other errors."""

    shared: Array
    relative: Array

    @property
    def total(self) -> Array:
        """Sum of both parts."""
        return self.shared + self.relative


# Of small matrices, threads cost more than they give: ten times as much where another process is busy.
@threadpool_limits.wrap(limits=1, user_api="blas")  # type: ignore[untyped-decorator]
def matched_covariance(
    source: Array,
    target: Array,
    transform: Similarity,
    *,
    sigma_m: Array,
    tilt_sigma_deg: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, float]:
    """Covariance (7, 7) of a transform from matches with spatially correlated errors.

    Correlation length and correlated fraction of the errors are unknown. The covariances for all pairs of both on a
    grid are averaged, weighted by the likelihood of the residuals (see `_likelihoods`). So the result includes the
    possibility of an error that is common to the whole model, which the adjustment absorbs in the transform.

    Args:
        source, target: (n, 3) each.
        transform: target from source, adjusted.
        sigma_m: (3,) standard deviation of a match per axis.
        tilt_sigma_deg: of the adjustment.
        rng: draws the matches that are used, where there are many.

    Returns:
        the covariance, the point (3,) it refers to (see `refine_similarity`), and the mean correlation length in metres
        of the horizontal errors.

    Raises `TooFewMatches` for fewer than eight, and `DegenerateGeometry` where they do not determine the transform.
    """
    n = len(source)
    if n < MIN_MATCHES:
        raise TooFewMatches(f"{n} matches are too few for a covariance; at least {MIN_MATCHES} are required")
    chosen = np.sort(rng.permutation(n)[:MATCHES])
    source, target = source[chosen], target[chosen]
    transformed = transform.apply(source)
    gap = cdist(transformed, transformed)
    lengths = [max(float(gap.max()) * ratio, 1.0) for ratio in CORRELATION_LENGTHS]
    few = np.sort(rng.permutation(len(chosen))[:LIKELIHOOD_MATCHES])
    residuals = (transformed - target)[few]
    correlations = [_matern32(gap[np.ix_(few, few)], length) for length in lengths]
    kinds = _likelihoods([residuals[:, :2], residuals[:, 2:]], transformed[few, :2], correlations)
    horizontal, vertical = _mean_covariances(gap, lengths, kinds, independent=len(chosen) / n)
    covariance, centre = sandwich_covariance(
        source,
        target,
        transform,
        [horizontal, horizontal, vertical],
        sigma_m=sigma_m,
        tilt_sigma_deg=tilt_sigma_deg,
    )
    return covariance, centre, float(kinds[0].posterior.sum(axis=1) @ lengths)


@threadpool_limits.wrap(limits=1, user_api="blas")  # type: ignore[untyped-decorator]
def plan_covariance(
    offsets: Array, residuals: Array, weights: Array, raised_m: Array | None, *, rng: np.random.Generator
) -> tuple[Array, float]:
    """Covariance (4, 4) of log scale, azimuth (rad), east and north (m) of a similarity in plan.

    The errors of neighbouring matches are correlated as in `matched_covariance`, by the same likelihood.

    Args:
        offsets: (n, 2) metres, positions of the model's points from the point that the covariance refers to.
        residuals: (n, 2) metres.
        weights: (n,) of the adjustment.
        raised_m: (n,) heights above ground, where a lean was adjusted with them; else None.
        rng: draws the matches that are used, where there are many.

    Returns:
        the covariance, and the mean correlation length in metres.

    Raises `TooFewMatches` for fewer than eight.
    """
    used = np.flatnonzero(weights > 0)
    if len(used) < MIN_MATCHES:
        raise TooFewMatches(f"{len(used)} matches are too few for a covariance; at least {MIN_MATCHES} are required")
    chosen = np.sort(rng.permutation(used)[:MATCHES])
    xy, w = offsets[chosen], weights[chosen]
    gap = cdist(xy, xy)
    lengths = [max(float(gap.max()) * ratio, 1.0) for ratio in CORRELATION_LENGTHS]
    few = np.sort(rng.permutation(len(chosen))[:LIKELIHOOD_MATCHES])
    correlations = [_matern32(gap[np.ix_(few, few)], length) for length in lengths]
    kinds = _likelihoods([residuals[chosen][few]], xy[few], correlations)
    (errors,) = _mean_covariances(gap, lengths, kinds, independent=len(chosen) / len(used))
    one, none = np.ones(len(xy)), np.zeros(len(xy))
    height = none if raised_m is None else raised_m[chosen]
    east = np.column_stack([xy[:, 0], -xy[:, 1], one, none, height, none])
    north = np.column_stack([xy[:, 1], xy[:, 0], none, one, none, height])
    keep = 4 if raised_m is None else 6
    designs = [design[:, :keep] for design in (east, north)]
    normal = sum((design.T * w) @ design for design in designs)
    spread = sum((design.T * w) @ errors @ (design.T * w).T for design in designs)
    # Metres and radians differ by the size of the model, as do heights: in one unit, the inverse is stable.
    size = np.sqrt(np.diag(normal))
    inverse = np.linalg.pinv(normal / np.outer(size, size)) / np.outer(size, size)
    return (inverse @ spread @ inverse)[:4, :4], float(kinds[0].posterior.sum(axis=1) @ lengths)


@dataclass(frozen=True, eq=False)
class _Kind:
    """Errors along some axes: posterior of correlation lengths and fractions, and variances for them, both (r, s)."""

    posterior: Array
    variances: Array


def _matern32(gap: Array, length: float) -> Array:
    """Matern correlation of smoothness 3/2 at distances `gap`, for a correlation length in the same unit."""
    scaled = np.sqrt(3.0) / length * gap
    return np.asarray((1 + scaled) * np.exp(-scaled))


def _likelihoods(kinds: list[Array], plan: Array, correlations: list[Array]) -> list[_Kind]:
    """Posterior of correlation lengths and fractions under a uniform prior.

    Restricted likelihood (Patterson and Thompson, Biometrika 1971): the fit removes a plane, and with it most of the
    long-range errors, from the residuals.

    Args:
        kinds: residuals (n, axes) of each kind of error.
        plan: (n, 2) positions.
        correlations: (n, n), one per correlation length.
    """
    n = len(plan)
    design = _plane_basis(plan)
    free = n - design.shape[1]
    logs, variances = (np.zeros((len(kinds), len(correlations), len(CORRELATED_FRACTIONS))) for _ in range(2))
    for k, correlation in enumerate(correlations):
        for m, fraction in enumerate(CORRELATED_FRACTIONS):
            root = cholesky(fraction * correlation + (1 - fraction) * np.eye(n), lower=True)
            fit = solve_triangular(root, design, lower=True)
            normal = fit.T @ fit
            volume = np.log(np.diag(root)).sum() + np.linalg.slogdet(normal)[1] / 2
            for kind, residuals in enumerate(kinds):
                left = solve_triangular(root, residuals, lower=True)
                left = left - fit @ np.linalg.solve(normal, fit.T @ left)
                variance = max(float(np.mean(np.sum(left**2, axis=0))) / free, SMALLEST_VARIANCE_M2)
                logs[kind, k, m] = -residuals.shape[1] * (volume + free * np.log(variance) / 2)
                variances[kind, k, m] = variance
    posteriors = np.exp(logs - logs.max(axis=(1, 2), keepdims=True))
    posteriors /= posteriors.sum(axis=(1, 2), keepdims=True)
    return [_Kind(*pair) for pair in zip(posteriors, variances, strict=True)]


def _plane_basis(plan: Array) -> Array:
    """Orthonormal basis (n, rank) of the functions a + b x + c y at positions (n, 2).

    Matches on a vertical wall are collinear in plan: b and c are not separable there, and the rank is 2.
    """
    design = np.column_stack([np.ones(len(plan)), plan - plan.mean(axis=0)])
    design[:, 1:] /= max(float(np.abs(design[:, 1:]).max()), 1e-12)
    basis, sizes, _ = np.linalg.svd(design, full_matrices=False)
    return np.asarray(basis[:, sizes > PLAN_RANK * sizes[0]])


def _mean_covariances(gap: Array, lengths: list[float], kinds: list[_Kind], *, independent: float) -> list[Array]:
    """Covariance (n, n) of the errors of each kind, averaged over all correlation lengths and fractions.

    A subset of the matches represents all of them, whose independent errors average out further: `independent` is the
    factor on the uncorrelated part of the variance.
    """
    fractions = np.array(CORRELATED_FRACTIONS)
    weights = [kind.posterior * kind.variances for kind in kinds]
    totals = [float((w * (1 - fractions)).sum()) * independent * np.eye(len(gap)) for w in weights]
    for k, length in enumerate(lengths):
        correlation = _matern32(gap, length)
        for total, w in zip(totals, weights, strict=True):
            total += float((w[k] * fractions).sum()) * correlation
    return totals


def camera_accuracy(
    registration: Registration,
    centres_enu: Array,
    reference: Reference,
    calibration: Calibration | None,
    shape_enu: Array | None = None,
    viewed_enu: Array | None = None,
) -> CameraAccuracy:
    """Predicted accuracy of camera positions.

    A focal length that is one percent too long puts every camera one percent too far from what it shows: too high, and
    with an oblique view also aside.

    After control, the covariance is that of the position on Earth: the reference's error is no part of it.

    Args:
        registration: with a covariance.
        centres_enu: (n, 3) metres.
        reference: its covariance is shared.
        calibration: uncertainty of the focal length; None to ignore it.
        viewed_enu: (n, 3) where the axis of each camera meets what it shows; None for straight below it.
        shape_enu: formal covariances (n, 3, 3) m^2 of the camera centres within the model, where they are known.

    Raises `TooFewMatches` for a registration without covariance.
    """
    if registration.covariance is None or registration.centroid_enu is None:
        raise TooFewMatches("a registration without a covariance has no predicted accuracy")
    centres = np.asarray(centres_enu, dtype=np.float64).reshape(-1, 3)
    away = focal_motion(centres, registration.centroid_enu, calibration, viewed_enu)
    focal_sigma = 0.0 if calibration is None else calibration.focal_sigma
    covariance, shared = block_diag(registration.covariance, focal_sigma**2), reference.covariance
    if registration.absolute is not None:
        covariance, shared = registration.absolute, np.zeros((3, 3))
    jacobian = np.concatenate([similarity_jacobian(centres - registration.centroid_enu), away[:, :, None]], axis=2)
    relative = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    if shape_enu is not None:
        relative = relative + SHAPE_FACTOR**2 * shape_enu
    return CameraAccuracy(np.broadcast_to(shared, relative.shape), relative)


def focal_motion(centres: Array, centroid: Array, calibration: Calibration | None, viewed: Array | None) -> Array:
    """By how much camera centres (n, 3) move with the logarithm of the focal length, (n, 3) metres; see above."""
    if calibration is None:
        return np.zeros_like(centres)
    return np.asarray((centres - centroid) * [0.0, 0.0, 1.0] if viewed is None else centres - viewed)
