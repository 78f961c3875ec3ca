# SPDX-License-Identifier: Apache-2.0
"""Planes and their robust fit to a point cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BATCH = 512
MAX_TRIALS = 20_000
# Points on which every hypothesis is scored; enough to rank planes.
SCREEN_POINTS = 2000
FLATNESS = 1e-7


@dataclass(frozen=True, eq=False)
class Plane:
    """The points x with normal @ x = offset; `normal` (3,) has length 1, `offset` is in the unit of the points."""

    normal: Array
    offset: float

    def __post_init__(self) -> None:
        normal = np.array(self.normal, dtype=np.float64)
        if normal.shape != (3,) or not np.isfinite([*normal, self.offset]).all():
            raise DegenerateGeometry("a plane needs a finite normal (3,) and offset")
        if abs(np.linalg.norm(normal) - 1.0) > 1e-6:
            raise DegenerateGeometry("the normal of a plane must have length 1")
        normal.flags.writeable = False
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "offset", float(self.offset))

    def height(self, points: ArrayLike) -> Array:
        """Signed distances (n,) of points (n, 3), positive on the side of the normal."""
        heights: Array = np.asarray(points, dtype=np.float64) @ self.normal - self.offset
        return heights


def fit_plane_ransac(
    points: ArrayLike,
    *,
    threshold: float,
    rng: np.random.Generator,
    weights: ArrayLike | None = None,
    max_tilt_from: tuple[ArrayLike, float] | None = None,
    confidence: float = 0.9999,
) -> tuple[Plane, Mask]:
    """Plane that most of the points (n, 3) lie near, with the mask (n,) of those within `threshold` of it.

    `threshold` has the unit of the points. `weights` (n,), not negative, count in the score and in the last fit;
    a point of weight 0 is never sampled. `max_tilt_from` = (direction (3,), degrees) admits only planes whose
    normal, oriented towards the direction, is that close to it; otherwise the normal points to z >= 0.
    The score is the truncated squared distance (MSAC), the last fit is by least squares on the inliers.

    Raises `TooFewMatches` below 3 points and `DegenerateGeometry` for points on one line or when no plane is
    within the limit of tilt.
    """
    xyz, w = _checked(points, weights, threshold)
    used = np.flatnonzero(w > 0)
    limit = _Limit.of(max_tilt_from)
    centre = np.median(xyz[used], axis=0)
    cloud, cloud_weights = xyz[used] - centre, w[used]
    _require_plane(cloud)
    screen = rng.permutation(len(cloud))[:SCREEN_POINTS]
    best: tuple[Array, float] | None = None
    best_score, trials, needed = -1.0, 0, float(MAX_TRIALS)
    while trials < min(needed, MAX_TRIALS):
        trials += BATCH
        normals, offsets = _planes(cloud, rng, limit)
        if not len(normals):
            continue
        gaps = np.abs(normals @ cloud[screen].T - offsets[:, None]) / threshold
        scores = np.maximum(1.0 - gaps**2, 0.0) @ cloud_weights[screen]
        k = int(np.argmax(scores))
        if scores[k] > best_score:
            best, best_score = (normals[k], float(offsets[k])), float(scores[k])
            good = float(np.mean(gaps[k] <= 1.0)) ** 3
            needed = 1.0 if good >= 1.0 else np.log1p(-confidence) / np.log1p(-max(good, 1e-12))
    if best is None:
        raise DegenerateGeometry("no plane through the points is within the limit of tilt")
    normal, offset = _refitted(cloud, cloud_weights, best, threshold, limit)
    plane = Plane(normal, offset + float(normal @ centre))
    return plane, np.abs(plane.height(xyz)) <= threshold


@dataclass(frozen=True, eq=False)
class _Limit:
    """The side of the normals, and the least cosine of their angle to it."""

    direction: Array
    min_cosine: float

    @classmethod
    def of(cls, max_tilt_from: tuple[ArrayLike, float] | None) -> _Limit:
        if max_tilt_from is None:
            return cls(np.array([0.0, 0.0, 1.0]), -1.0)
        direction = np.asarray(max_tilt_from[0], dtype=np.float64)
        length = float(np.linalg.norm(direction))
        if direction.shape != (3,) or not np.isfinite(length) or length == 0:
            raise DegenerateGeometry("the direction that limits the tilt must be a finite, non-zero vector (3,)")
        return cls(direction / length, float(np.cos(np.radians(max_tilt_from[1]))))


def _planes(cloud: Array, rng: np.random.Generator, limit: _Limit) -> tuple[Array, Array]:
    """Normals (k, 3) and offsets (k,) of planes through random triples, those that are determined and admitted."""
    a, b, c = cloud[rng.integers(0, len(cloud), (BATCH, 3))].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    determined = lengths > 1e-9 * np.sum((b - a) ** 2 + (c - a) ** 2, axis=1)
    normals = normals[determined] / lengths[determined, None]
    normals *= np.where(normals @ limit.direction < 0, -1.0, 1.0)[:, None]
    admitted = normals @ limit.direction >= limit.min_cosine
    normals = normals[admitted]
    return normals, np.sum(normals * a[determined][admitted], axis=1)


def _refitted(
    cloud: Array, weights: Array, start: tuple[Array, float], threshold: float, limit: _Limit
) -> tuple[Array, float]:
    """Least squares on the inliers, repeated until they are stable; the start where that exceeds the limit of tilt."""
    normal, offset = start
    for _ in range(5):
        near = np.abs(cloud @ normal - offset) <= threshold
        if np.count_nonzero(near) < 3:
            break
        mean = np.average(cloud[near], axis=0, weights=weights[near])
        arms = (cloud[near] - mean) * np.sqrt(weights[near])[:, None]
        _, spread, axes = np.linalg.svd(arms, full_matrices=False)
        candidate = axes[2] * (-1.0 if axes[2] @ limit.direction < 0 else 1.0)
        if spread[1] <= FLATNESS * spread[0] or candidate @ limit.direction < limit.min_cosine:
            break
        normal, offset = candidate, float(candidate @ mean)
    return normal, offset


def _checked(points: ArrayLike, weights: ArrayLike | None, threshold: float) -> tuple[Array, Array]:
    xyz = np.asarray(points, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ValueError(f"points {xyz.shape} must be (n, 3)")
    if not threshold > 0:
        raise ValueError(f"threshold must be positive, not {threshold}")
    w = np.ones(len(xyz)) if weights is None else np.asarray(weights, dtype=np.float64)
    if w.shape != (len(xyz),) or not np.isfinite(w).all() or (w < 0).any():
        raise ValueError("weights must be (n,), finite and not negative")
    if np.count_nonzero(w) < 3:
        raise TooFewMatches(f"{np.count_nonzero(w)} points; a plane needs at least 3")
    if not np.isfinite(xyz).all():
        raise DegenerateGeometry("the points must have finite coordinates")
    return xyz, w


def _require_plane(cloud: Array) -> None:
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(cloud.T)), 0.0))
    # The root of a rounded variance is itself good to about 1e-8 only.
    if spread[1] <= FLATNESS * spread[2] or spread[2] == 0:
        raise DegenerateGeometry("the points lie on one line and do not determine a plane")
