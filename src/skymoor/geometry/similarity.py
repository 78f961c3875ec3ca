# SPDX-License-Identifier: Apache-2.0
"""Similarities of space and their closed-form fits to corresponding points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches

Array = NDArray[np.float64]

ROTATION_TOLERANCE = 1e-6
# Relative spread below which a cloud counts as a point or a line: well above the rounding of UTM-sized float64
# coordinates (1e-9 m over 100 m), well below the extent of real matches.
FLATNESS = 1e-7


@dataclass(frozen=True, eq=False)
class Similarity:
    """x_target = scale * rotation @ x_source + translation.

    `rotation` (3, 3) is proper, `translation` (3,) is in target units. Raises `DegenerateGeometry` when a value is
    not finite, the scale is not positive, or the matrix is not a rotation within 1e-6.
    """

    scale: float
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        scale = float(self.scale)
        rotation = _read_only(self.rotation)
        translation = _read_only(self.translation)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(f"rotation {rotation.shape} must be (3, 3) and translation {translation.shape} (3,)")
        if not (np.isfinite(scale) and np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise DegenerateGeometry("a similarity must have finite values")
        if scale <= 0:
            raise DegenerateGeometry(f"the scale of a similarity must be positive, not {scale:g}")
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
            raise DegenerateGeometry("the matrix of a similarity is not a proper rotation")
        object.__setattr__(self, "scale", scale)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> Similarity:
        """The identity transform."""
        return cls(1.0, np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion_wxyz(cls, scale: float, quaternion_wxyz: ArrayLike, translation: ArrayLike) -> Similarity:
        """Build from a quaternion (4,), scalar first, of any non-zero length."""
        quaternion = np.asarray(quaternion_wxyz, dtype=np.float64)
        if quaternion.shape != (4,):
            raise ValueError(f"a quaternion has 4 numbers, not shape {quaternion.shape}")
        length = float(np.linalg.norm(quaternion))
        if not np.isfinite(length) or length < 1e-12:
            raise DegenerateGeometry("a quaternion of length zero or with values that are not finite is not a rotation")
        rotation = scipy.spatial.transform.Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        return cls(scale, rotation, np.asarray(translation, dtype=np.float64))

    @property
    def quaternion_wxyz(self) -> Array:
        """Unit quaternion (4,), scalar first and not negative."""
        quaternion = scipy.spatial.transform.Rotation.from_matrix(self.rotation).as_quat(
            canonical=True, scalar_first=True
        )
        return cast(Array, quaternion)

    def matrix(self) -> Array:
        """Homogeneous matrix (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    def inverse(self) -> Similarity:
        """source_from_target."""
        return Similarity(1.0 / self.scale, self.rotation.T, -(self.rotation.T @ self.translation) / self.scale)

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from source to target."""
        return np.asarray(points, dtype=np.float64) @ (self.scale * self.rotation).T + self.translation

    def __matmul__(self, other: Similarity) -> Similarity:
        """Compose: `(c_from_b @ b_from_a).apply(x_a)` is in c."""
        return Similarity(self.scale * other.scale, self.rotation @ other.rotation, self.apply(other.translation))


def umeyama(
    source: ArrayLike,
    target: ArrayLike,
    weights: ArrayLike | None = None,
    with_scale: bool = True,  # noqa: FBT001, FBT002
) -> Similarity:
    """Similarity that minimises the weighted squared distances in the target frame (S. Umeyama, PAMI 1991).

    `source`, `target` (n, 3), `weights` (n,) not negative. The scale assumes that the errors are in the target; the
    geometric mean of both spreads, which some use, would grow with the noise. Points in one plane are enough.

    Raises `TooFewMatches` below 3 points, `DegenerateGeometry` for coincident or collinear points, and for mirrored
    data whose best rotation is not unique; other mirrored data give the best proper rotation.
    """
    pairs = _Centred.from_points(source, target, weights, minimum=3)
    for name, points in (("source", pairs.source), ("target", pairs.target)):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= FLATNESS * spread[0]:
            raise DegenerateGeometry(f"the {name} points lie on one line and do not determine the rotation about it")
    cross = pairs.target.T @ pairs.source
    u, d, vt = np.linalg.svd(cross)
    if d[1] <= FLATNESS**2 * d[0]:
        raise DegenerateGeometry(
            "source and target points correlate along one line only and do not determine the rotation"
        )
    signs = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        if d[1] - d[2] <= 1e-9 * d[0]:
            raise DegenerateGeometry("the points are mirrored and symmetric: the best rotation is not unique")
        signs[2] = -1.0
    rotation = (u * signs) @ vt
    scale = float(d @ signs / np.sum(pairs.source**2)) if with_scale else 1.0
    return pairs.similarity(scale, rotation)


def umeyama_level(source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None) -> Similarity:
    """Least-squares similarity that rotates about z only, for frames that both have z up.

    `source`, `target` (n, 3), `weights` (n,) not negative. With the plan as complex numbers p, q and heights h, g
    (all centred), the rotation angle is the argument of a = sum w q conj(p), and the scale is
    (|a| + sum w g h) / sum w (|p|^2 + h^2).

    Raises `TooFewMatches` below 2 points and `DegenerateGeometry` when the plan positions coincide, no rotation
    fits best, or the heights contradict every positive scale.
    """
    pairs = _Centred.from_points(source, target, weights, minimum=2)
    plan_source = pairs.source[:, 0] + 1j * pairs.source[:, 1]
    plan_target = pairs.target[:, 0] + 1j * pairs.target[:, 1]
    for name, plan, points in (("source", plan_source, pairs.source), ("target", plan_target, pairs.target)):
        if np.linalg.norm(plan) <= FLATNESS * np.linalg.norm(points):
            raise DegenerateGeometry(f"the {name} points coincide in plan and do not determine the rotation")
    product = complex(np.vdot(plan_source, plan_target))
    if abs(product) <= FLATNESS**2 * np.linalg.norm(plan_source) * np.linalg.norm(plan_target):
        raise DegenerateGeometry("no rotation about z fits the points better than another")
    vertical = float(pairs.source[:, 2] @ pairs.target[:, 2])
    scale = (abs(product) + vertical) / float(np.sum(pairs.source**2))
    if scale <= 0:
        raise DegenerateGeometry("the heights contradict every positive scale")
    cos, sin = product.real / abs(product), product.imag / abs(product)
    return pairs.similarity(scale, np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]))


@dataclass(frozen=True, eq=False)
class _Centred:
    """Corresponding points minus their weighted means, times the root of their normalised weights."""

    source: Array
    target: Array
    source_mean: Array
    target_mean: Array

    @classmethod
    def from_points(cls, source: ArrayLike, target: ArrayLike, weights: ArrayLike | None, *, minimum: int) -> _Centred:
        xyz_source = np.asarray(source, dtype=np.float64)
        xyz_target = np.asarray(target, dtype=np.float64)
        if xyz_source.ndim != 2 or xyz_source.shape[1] != 3 or xyz_source.shape != xyz_target.shape:
            raise ValueError(f"source {xyz_source.shape} and target {xyz_target.shape} must both be (n, 3)")
        w = np.ones(len(xyz_source)) if weights is None else np.asarray(weights, dtype=np.float64)
        if w.shape != (len(xyz_source),) or not np.isfinite(w).all() or (w < 0).any():
            raise ValueError("weights must be (n,), finite and not negative")
        used = w > 0
        if np.count_nonzero(used) < minimum:
            raise TooFewMatches(f"{np.count_nonzero(used)} correspondences; at least {minimum} are required")
        xyz_source, xyz_target, w = xyz_source[used], xyz_target[used], w[used] / w[used].sum()
        if not (np.isfinite(xyz_source).all() and np.isfinite(xyz_target).all()):
            raise DegenerateGeometry("the correspondences must have finite coordinates")
        centred = []
        for name, points in (("source", xyz_source), ("target", xyz_target)):
            # Two steps, since the mean of UTM-sized numbers is itself rounded.
            mean = points[0] + w @ (points - points[0])
            if np.abs(points - mean).max() <= 1e-12 * max(float(np.abs(mean).max()), 1e-300):
                raise DegenerateGeometry(f"the {name} points coincide")
            centred += [(points - mean) * np.sqrt(w)[:, None], mean]
        return cls(centred[0], centred[2], centred[1], centred[3])

    def similarity(self, scale: float, rotation: Array) -> Similarity:
        return Similarity(scale, rotation, self.target_mean - scale * (rotation @ self.source_mean))


def _read_only(values: ArrayLike) -> Array:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
