# SPDX-License-Identifier: Apache-2.0
"""The weighted 7-parameter adjustment of a similarity, with its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, cast

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry.similarity import Similarity

Array = NDArray[np.float64]
Loss = Literal["tukey", "huber"]

# Tuning constants of the losses, in standard deviations of a 3D residual: 95 % efficiency under Gaussian noise.
TUKEY_CUT = 5.49
HUBER_CUT = 1.63
CONDITION = 1e-10


def refine_similarity(
    source: ArrayLike,
    target: ArrayLike,
    initial: Similarity,
    *,
    sigma_m: float | ArrayLike,
    iterations: int = 20,
    loss: Loss = "tukey",
    tilt_sigma_deg: float | None = None,
) -> tuple[Similarity, Array, Array]:
    """Adjust all 7 parameters by reweighted Gauss-Newton; returns transform, covariance (7, 7) and weights (n,).

    `source`, `target` (n, 3); `sigma_m` is the standard deviation of a correspondence in the target frame, one
    number or one per axis, and scales the loss. With `tilt_sigma_deg`, the tilt of the transform
    away from level counts as an observation of zero with that standard deviation, about each horizontal axis.

    Gauge of the covariance: the true transform is x -> c + t + exp(l) exp([w]) (T(x) - c) with T the returned one,
    and the covariance is of (l, w in radians, t in metres), all in the target frame. The fixed point c is
    `gauge_centre(T, source, weights)`, the weighted centroid, which makes t nearly independent of the rest.
    `point_covariance` propagates it to any point. The covariance follows M-estimation theory (Huber 1981) for the
    loss, scaled by the a-posteriori variance factor, and is never smaller than `sigma_m` implies.

    Raises `TooFewMatches` when fewer correspondences than needed lie near the initial transform (3, or 2 with the
    tilt observation) and `DegenerateGeometry` when they do not determine all parameters.
    """
    problem = _Problem.from_points(source, target, sigma_m, loss, tilt_sigma_deg)
    current = initial
    for _ in range(iterations):
        step, centre, size = problem.step(current)
        current = moved_similarity(current, step, centre)
        if np.linalg.norm(step * [size, size, size, size, 1, 1, 1]) < 1e-9 * problem.sigma.min():
            break
    weights = problem.weights(problem.lengths(current))
    return current, problem.covariance(current), weights


def sandwich_covariance(
    source: ArrayLike,
    target: ArrayLike,
    transform: Similarity,
    correlated: Sequence[ArrayLike],
    *,
    sigma_m: float | ArrayLike,
    loss: Loss = "tukey",
    tilt_sigma_deg: float | None = None,
) -> tuple[Array, Array]:
    """The covariance (7, 7) of `refine_similarity` where errors are not independent, and the point (3,) it refers to.

    `correlated` are three covariances (n, n) in m^2 of the errors of all correspondences, along east, north and up;
    the other arguments, and what is raised, are those of `refine_similarity`. Huber, Robust Statistics, 1981.
    """
    problem = _Problem.from_points(source, target, sigma_m, loss, tilt_sigma_deg)
    return problem.sandwich(transform, [np.asarray(of_axis, dtype=np.float64) for of_axis in correlated])


def gauge_centre(transform: Similarity, source: ArrayLike, weights: ArrayLike) -> Array:
    """The point (3,) of the target frame to which the covariance of `refine_similarity` refers."""
    return cast(Array, np.average(transform.apply(source), axis=0, weights=np.asarray(weights)))


def point_covariance(covariance: Array, centre: Array, points: ArrayLike) -> Array:
    """Covariances (n, 3, 3) in m^2 of points (n, 3) in the target frame, from the (7, 7) one and its centre."""
    jacobian = similarity_jacobian(np.asarray(points, dtype=np.float64).reshape(-1, 3) - centre)
    return jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)


def tilt_deg(similarity: Similarity) -> float:
    """Angle in degrees between the z axis before and after the rotation."""
    x, y, z = similarity.rotation[:, 2]
    return float(np.degrees(np.arctan2(np.hypot(x, y), z)))


@dataclass(frozen=True, eq=False)
class _Problem:
    source: Array
    target: Array
    sigma: Array
    loss: Loss
    tilt_sigma: float | None  # radians

    @classmethod
    def from_points(
        cls, source: ArrayLike, target: ArrayLike, sigma_m: float | ArrayLike, loss: Loss, tilt_sigma_deg: float | None
    ) -> _Problem:
        xyz_source, xyz_target = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
        if xyz_source.ndim != 2 or xyz_source.shape[1] != 3 or xyz_source.shape != xyz_target.shape:
            raise ValueError(f"source {xyz_source.shape} and target {xyz_target.shape} must both be (n, 3)")
        if not (np.isfinite(xyz_source).all() and np.isfinite(xyz_target).all()):
            raise DegenerateGeometry("the correspondences must have finite coordinates")
        sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (3,))
        if not (sigma > 0).all() or not np.isfinite(sigma).all():
            raise ValueError(f"sigma_m must be positive, not {sigma}")
        if tilt_sigma_deg is not None and not tilt_sigma_deg > 0:
            raise ValueError(f"tilt_sigma_deg must be positive, not {tilt_sigma_deg}")
        tilt_sigma = None if tilt_sigma_deg is None else float(np.radians(tilt_sigma_deg))
        return cls(xyz_source, xyz_target, sigma, loss, tilt_sigma)

    def lengths(self, transform: Similarity) -> Array:
        """Residual lengths (n,) in standard deviations."""
        lengths: Array = np.linalg.norm((self.target - transform.apply(self.source)) / self.sigma, axis=1)
        return lengths

    def weights(self, lengths: Array) -> Array:
        return _weights(self.loss, lengths)

    def step(self, transform: Similarity) -> tuple[Array, Array, float]:
        """Gauss-Newton step (7,), its fixed point (3,), and the radius of the data around that point."""
        weights = self._checked_weights(transform)
        centre = gauge_centre(transform, self.source, weights)
        transformed = transform.apply(self.source)
        root = np.sqrt(weights)[:, None] / self.sigma
        jacobian = (similarity_jacobian(transformed - centre) * root[:, :, None]).reshape(-1, 7)
        right = jacobian.T @ ((self.target - transformed) * root).ravel()
        tilt_normal, tilt_right = self._tilt_equations(transform)
        size = _radius(transformed - centre, weights)
        return _inverse(jacobian.T @ jacobian + tilt_normal, size) @ (right + tilt_right), centre, size

    def covariance(self, transform: Similarity) -> Array:
        weights = self._checked_weights(transform)
        points = transform.apply(self.source) - gauge_centre(transform, self.source, weights)
        root = np.sqrt(weights)[:, None] / self.sigma
        jacobian = (similarity_jacobian(points) * root[:, :, None]).reshape(-1, 7)
        lengths, slopes = self.lengths(transform), _slopes(self.loss, self.lengths(transform))
        expected_slope, expected_square, expected_weight = _gaussian_means(self.loss)
        factor = floor = (expected_square / expected_weight) / (expected_slope / expected_weight) ** 2
        observations = 3.0 * weights.sum() / expected_weight
        if observations > 7.0:
            slope = max(float(slopes.sum() / weights.sum()), 0.1 * expected_slope)
            square = float(np.sum((weights * lengths) ** 2) / 3.0 / weights.sum()) * observations / (observations - 7.0)
            factor = max(square / slope**2, floor)
        tilt_normal, _ = self._tilt_equations(transform)
        return _inverse(jacobian.T @ jacobian / factor + tilt_normal, _radius(points, weights))

    def sandwich(self, transform: Similarity, correlated: Sequence[Array]) -> tuple[Array, Array]:
        weights = self._checked_weights(transform)
        centre = gauge_centre(transform, self.source, weights)
        points = transform.apply(self.source) - centre
        jacobian = similarity_jacobian(points)
        slope = max(float(_slopes(self.loss, self.lengths(transform)).sum() / weights.sum()), 0.1)
        scores = jacobian * (weights[:, None] / self.sigma**2)[:, :, None]
        normal = slope * np.einsum("nij,nik->jk", scores, jacobian)
        spread = sum(scores[:, axis].T @ correlated[axis] @ scores[:, axis] for axis in range(3))
        tilt_normal, _ = self._tilt_equations(transform)
        inverse = _inverse(normal + tilt_normal, _radius(points, weights))
        return inverse @ (spread + tilt_normal) @ inverse, centre

    def _checked_weights(self, transform: Similarity) -> Array:
        weights = self.weights(self.lengths(transform))
        needed = 3 if self.tilt_sigma is None else 2
        near = int(np.count_nonzero(weights > 1e-6))
        if near < needed:
            raise TooFewMatches(f"{near} correspondences agree with the transform; at least {needed} are required")
        return weights

    def _tilt_equations(self, transform: Similarity) -> tuple[Array, Array]:
        """Normal equations of the observation that the rotated z axis has no horizontal part."""
        if self.tilt_sigma is None:
            return np.zeros((7, 7)), np.zeros(7)
        axis = transform.rotation[:, 2]
        jacobian = np.zeros((2, 7))
        jacobian[:, 1:4] = -_cross_matrices(axis[None])[0, :2] / self.tilt_sigma
        return jacobian.T @ jacobian, jacobian.T @ (-axis[:2] / self.tilt_sigma)


def moved_similarity(transform: Similarity, step: Array, centre: Array) -> Similarity:
    """x -> c + t + exp(l) exp([w]) (T(x) - c) of a transform T, a step (7,) of l, w and t, and c = `centre` (3,)."""
    scale = float(np.exp(step[0]))
    rotation = scipy.spatial.transform.Rotation.from_rotvec(step[1:4]).as_matrix()
    about_centre = Similarity(scale, rotation, centre + step[4:] - scale * (rotation @ centre))
    return about_centre @ transform


def similarity_jacobian(points: Array) -> Array:
    """Derivative (n, 3, 7) of points, given from the gauge centre, by (log scale, rotation vector, translation)."""
    jacobian = np.zeros((len(points), 3, 7))
    jacobian[:, :, 0] = points
    jacobian[:, :, 1:4] = -_cross_matrices(points)
    jacobian[:, :, 4:] = np.eye(3)
    return jacobian


def _cross_matrices(vectors: Array) -> Array:
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices


def _radius(points: Array, weights: Array) -> float:
    return max(float(np.sqrt(weights @ np.sum(points**2, axis=1) / weights.sum())), 1e-12)


def _inverse(normal: Array, size: float) -> Array:
    """Inverse of normal equations (7, 7), scaled so that metres and radians are comparable."""
    balance = np.array([1.0 / size] * 4 + [1.0] * 3)
    values, vectors = np.linalg.eigh(normal * balance[:, None] * balance)
    if not values[0] > CONDITION * values[-1]:
        raise DegenerateGeometry("the correspondences do not determine the similarity (all on one line?)")
    return cast(Array, (vectors / values) @ vectors.T * balance[:, None] * balance)


def _weights(loss: Loss, lengths: Array) -> Array:
    if loss == "tukey":
        return cast(Array, np.maximum(1.0 - (lengths / TUKEY_CUT) ** 2, 0.0) ** 2)
    return cast(Array, np.minimum(1.0, HUBER_CUT / np.maximum(lengths, HUBER_CUT)))


def _slopes(loss: Loss, lengths: Array) -> Array:
    """Mean derivative over the 3 axes of the influence w(m) u, which is w + m w' / 3."""
    if loss == "tukey":
        share = (lengths / TUKEY_CUT) ** 2
        return np.where(share < 1.0, (1.0 - share) ** 2 - 4.0 / 3.0 * share * (1.0 - share), 0.0)
    return np.where(lengths < HUBER_CUT, 1.0, 2.0 / 3.0 * _weights(loss, lengths))


@lru_cache
def _gaussian_means(loss: Loss) -> tuple[float, float, float]:
    """Means of slope, of squared influence per axis and of weight for 3D residuals of unit standard deviation."""

    def mean(of: str) -> float:
        def integrand(length: float) -> float:
            m = np.array([length])
            value = {
                "slope": _slopes(loss, m),
                "square": (_weights(loss, m) * m) ** 2 / 3.0,
                "weight": _weights(loss, m),
            }
            of_chi = np.sqrt(2 / np.pi) * length**2 * np.exp(-(length**2) / 2)  # density of the length
            return float(value[of][0] * of_chi)

        cut = TUKEY_CUT if loss == "tukey" else HUBER_CUT
        return float(scipy.integrate.quad(integrand, 0.0, cut)[0] + scipy.integrate.quad(integrand, cut, cut + 12.0)[0])

    return mean("slope"), mean("square"), mean("weight")
