# SPDX-License-Identifier: Apache-2.0
"""Robust similarities: vectorised RANSAC with local refinement; the adjustment after it is in `adjust`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry.adjust import refine_similarity, tilt_deg
from skymoor.geometry.similarity import Similarity, umeyama, umeyama_level

__all__ = ["RansacResult", "ransac_similarity", "refine_similarity", "tilt_deg"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

BATCH = 512
# Points on which every hypothesis of a batch is scored first; the best few are scored on all points.
SCREEN_POINTS = 1000
SCREEN_KEEP = 8


@dataclass(frozen=True, eq=False)
class RansacResult:
    """The best similarity, target from source, with the correspondences (n,) that it explains."""

    transform: Similarity
    inliers: Mask
    n_trials: int


@dataclass(frozen=True, eq=False)
class _Hypotheses:
    """Many similarities: scale (k,), rotation (k, 3, 3), translation (k, 3); invalid ones are left out."""

    scale: Array
    rotation: Array
    translation: Array

    def squared_errors(self, source: Array, target: Array) -> Array:
        """Squared distances (k, n) in the target frame."""
        linear = self.scale[:, None, None] * self.rotation
        total = np.zeros((len(self.scale), len(source)))
        for axis in range(3):  # one axis at a time keeps the memory to (k, n)
            gap = linear[:, axis] @ source.T + self.translation[:, axis, None] - target[:, axis]
            total += gap * gap
        return total

    def take(self, index: Index | Mask) -> _Hypotheses:
        return _Hypotheses(self.scale[index], self.rotation[index], self.translation[index])

    def at(self, k: int) -> Similarity:
        return Similarity(float(self.scale[k]), self.rotation[k], self.translation[k])


def ransac_similarity(
    source: ArrayLike,
    target: ArrayLike,
    *,
    inlier_m: float,
    rng: np.random.Generator,
    level: bool = True,
    confidence: float = 0.9999,
    max_trials: int = 20000,
    min_scale: float = 0.0,
    max_scale: float = float("inf"),
) -> RansacResult:
    """Similarity that explains most of the correspondences (n, 3) up to `inlier_m`, measured in the target frame.

    With `level` both frames have z up and two correspondences make a hypothesis, else three. Hypotheses are scored
    by the truncated squared error (MSAC, Torr & Zisserman 2000) and the best are refitted to their own inliers
    (LO-RANSAC, Chum et al. 2003). The last fit has all 7 parameters where the inliers determine them. Sampling
    stops once a better hypothesis would have been sampled with probability `confidence`. Scales outside `min_scale`
    to `max_scale` (target metres per source unit) are not considered. The same `rng` state gives the same result.

    Raises `TooFewMatches` with fewer correspondences than a sample needs, `DegenerateGeometry` when no sample gives
    a hypothesis.
    """
    xyz_source, xyz_target = _checked(source, target, minimum=2 if level else 3)
    if not (inlier_m > 0 and 0 <= min_scale <= max_scale and 0 < confidence < 1):
        raise ValueError("inlier_m must be positive, min_scale <= max_scale, and confidence between 0 and 1")
    # Centring keeps the products of UTM-sized coordinates exact to far below a millimetre.
    source_centre, target_centre = np.median(xyz_source, axis=0), np.median(xyz_target, axis=0)
    search = _Search(xyz_source - source_centre, xyz_target - target_centre, inlier_m, level, (min_scale, max_scale))
    n, size = len(xyz_source), 2 if level else 3
    screen = rng.permutation(n)[:SCREEN_POINTS]
    best: Similarity | None = None
    best_cost, trials, needed = np.inf, 0, float(max_trials)
    while trials < min(needed, max_trials):
        batch = min(BATCH, max_trials - trials)
        trials += batch
        hypotheses = search.hypotheses(_samples(n, size, batch, rng))
        if not len(hypotheses.scale):
            continue
        candidate, cost = search.best_of(hypotheses, screen)
        if cost < best_cost:
            best, best_cost = search.refitted(candidate, cost)
            share = np.mean(search.errors(best) <= inlier_m)
            needed = _trials_needed(float(share), size, confidence)
    if best is None:
        raise DegenerateGeometry("no sample of correspondences determines a similarity within the limits of scale")
    final, _ = search.refitted_fully(best, best_cost)
    inliers = search.errors(final) <= inlier_m
    shift = target_centre - final.scale * (final.rotation @ source_centre)
    return RansacResult(Similarity(final.scale, final.rotation, final.translation + shift), inliers, trials)


@dataclass(frozen=True, eq=False)
class _Search:
    """Centred correspondences, and the limits of inliers and scales."""

    source: Array
    target: Array
    inlier_m: float
    level: bool
    scales: tuple[float, float]

    def hypotheses(self, samples: Index) -> _Hypotheses:
        fit = _fit_pairs_level if self.level else _fit_triples
        hypotheses, usable = fit(self.source[samples], self.target[samples])
        usable &= (hypotheses.scale >= self.scales[0]) & (hypotheses.scale <= self.scales[1])
        return hypotheses.take(usable)

    def best_of(self, hypotheses: _Hypotheses, screen: Index) -> tuple[Similarity, float]:
        if len(screen) < len(self.source) and len(hypotheses.scale) > SCREEN_KEEP:
            costs = self._costs(hypotheses, self.source[screen], self.target[screen])
            hypotheses = hypotheses.take(np.argsort(costs, kind="stable")[:SCREEN_KEEP])
        costs = self._costs(hypotheses, self.source, self.target)
        best = int(np.argmin(costs))
        return hypotheses.at(best), float(costs[best])

    def refitted(self, start: Similarity, cost: float) -> tuple[Similarity, float]:
        """Refit to the inliers of a threshold that shrinks to `inlier_m`; keep the fit of least cost."""
        best, best_cost, current = start, cost, start
        for widening in (2.0, 1.5, 1.2, 1.0, 1.0):
            chosen = self.errors(current) <= widening * self.inlier_m
            try:
                current = (umeyama_level if self.level else umeyama)(self.source[chosen], self.target[chosen])
            except (TooFewMatches, DegenerateGeometry):
                break
            current_cost = self._cost(current)
            if current_cost < best_cost:
                best, best_cost = current, current_cost
        return best, best_cost

    def refitted_fully(self, start: Similarity, cost: float) -> tuple[Similarity, float]:
        """Fit all 7 parameters where the inliers determine the tilt: extended in two directions beyond the noise."""
        best, best_cost, current = start, cost, start
        for _ in range(3):
            chosen = self.errors(current) <= self.inlier_m
            if np.count_nonzero(chosen) < 6:
                break
            inliers = self.target[chosen] - self.target[chosen].mean(axis=0)
            spread = np.linalg.svd(inliers, compute_uv=False)[1] / np.sqrt(len(inliers))
            if spread < 3.0 * self.inlier_m:
                break
            try:
                current = umeyama(self.source[chosen], self.target[chosen])
            except DegenerateGeometry:
                break
            current_cost = self._cost(current)
            if current_cost < best_cost:
                best, best_cost = current, current_cost
        return best, best_cost

    def errors(self, transform: Similarity) -> Array:
        """Distances (n,) in the target frame."""
        distances: Array = np.linalg.norm(transform.apply(self.source) - self.target, axis=1)
        return distances

    def _cost(self, transform: Similarity) -> float:
        if not self.scales[0] <= transform.scale <= self.scales[1]:
            return float("inf")
        return float(np.minimum((self.errors(transform) / self.inlier_m) ** 2, 1.0).sum())

    def _costs(self, hypotheses: _Hypotheses, source: Array, target: Array) -> Array:
        costs = np.empty(len(hypotheses.scale))
        step = max(1, 4_000_000 // len(source))  # 32 MB at a time
        for start in range(0, len(costs), step):
            part = hypotheses.take(np.arange(start, min(start + step, len(costs))))
            squared = part.squared_errors(source, target)
            costs[start : start + step] = np.minimum(squared / self.inlier_m**2, 1.0).sum(axis=1)
        return costs


def _samples(n: int, size: int, count: int, rng: np.random.Generator) -> Index:
    """Index sets (count, size) without repetition inside a set."""
    samples = rng.integers(0, n, (count, size))
    while True:
        ordered = np.sort(samples, axis=1)
        repeated = (np.diff(ordered, axis=1) == 0).any(axis=1)
        if not repeated.any():
            return samples
        samples[repeated] = rng.integers(0, n, (int(repeated.sum()), size))


def _trials_needed(inlier_share: float, size: int, confidence: float) -> float:
    good = inlier_share**size
    if good >= 1.0:
        return 1.0
    return float(np.log1p(-confidence) / np.log1p(-good)) if good > 1e-12 else float("inf")


def _fit_pairs_level(source: Array, target: Array) -> tuple[_Hypotheses, Mask]:
    """`umeyama_level` of samples (k, 2, 3), with a mask of those that are determined."""
    a, b = source[:, 1] - source[:, 0], target[:, 1] - target[:, 0]
    product = (b[:, 0] + 1j * b[:, 1]) * (a[:, 0] - 1j * a[:, 1])
    length = np.abs(product)
    size = np.sum(a * a, axis=1)
    usable = (length > 1e-6 * np.sqrt(size * np.sum(b * b, axis=1))) & (size > 0)
    scale = (length + a[:, 2] * b[:, 2]) / np.where(size > 0, size, 1.0)
    usable &= scale > 0
    phase = product / np.where(length > 0, length, 1.0)
    rotation = np.zeros((len(a), 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = phase.real
    rotation[:, 1, 0], rotation[:, 0, 1] = phase.imag, -phase.imag
    rotation[:, 2, 2] = 1.0
    return _Hypotheses(scale, rotation, _translations(scale, rotation, source, target)), usable


def _fit_triples(source: Array, target: Array) -> tuple[_Hypotheses, Mask]:
    """`umeyama` of samples (k, 3, 3), with a mask of those that are determined."""
    a = source - source.mean(axis=1, keepdims=True)
    b = target - target.mean(axis=1, keepdims=True)
    size = np.sum(a * a, axis=(1, 2))
    u, d, vt = np.linalg.svd(np.einsum("kni,knj->kij", b, a))
    signs = np.ones((len(a), 3))
    signs[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = (u * signs[:, None, :]) @ vt
    scale = np.sum(d * signs, axis=1) / np.where(size > 0, size, 1.0)
    usable = (d[:, 1] > 1e-6 * d[:, 0]) & (d[:, 0] > 0) & (scale > 0)
    return _Hypotheses(scale, rotation, _translations(scale, rotation, source, target)), usable


def _translations(scale: Array, rotation: Array, source: Array, target: Array) -> Array:
    rotated = np.einsum("kij,kj->ki", rotation, source.mean(axis=1))
    translations: Array = target.mean(axis=1) - scale[:, None] * rotated
    return translations


def _checked(source: ArrayLike, target: ArrayLike, *, minimum: int) -> tuple[Array, Array]:
    xyz_source, xyz_target = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    if xyz_source.ndim != 2 or xyz_source.shape[1] != 3 or xyz_source.shape != xyz_target.shape:
        raise ValueError(f"source {xyz_source.shape} and target {xyz_target.shape} must both be (n, 3)")
    if len(xyz_source) < minimum:
        raise TooFewMatches(f"{len(xyz_source)} correspondences; at least {minimum} are required")
    if not (np.isfinite(xyz_source).all() and np.isfinite(xyz_target).all()):
        raise DegenerateGeometry("the correspondences must have finite coordinates")
    return xyz_source, xyz_target
