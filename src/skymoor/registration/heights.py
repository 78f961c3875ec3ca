# SPDX-License-Identifier: Apache-2.0
"""Heights of a model against those of the reference: offset, slope, scale, and how far each can be trusted.

The two surfaces are compared over their common area at the resolution of the elevation model, which is estimated: files
of 0.5 m that were interpolated from 30 m are everywhere. The elevation model's own error is not believed but measured:
from what the robust fit leaves, by jackknife over blocks (Kunsch, Annals of Statistics 1989), because
errors of neighbouring heights are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from skymoor.geo import Grid
from skymoor.registration.detail import BLUR_M, BLURS_M, WORKING_M, averaged, blur_range, blurred
from skymoor.types import Array, Array32, Mask

BLOCK_M, BLOCK_BLURS = 12.0, 4.0  # side of a jackknife block: metres, and in sigmas of the blur
MIN_BLOCKS, MIN_PIXELS = 8, 50
DOF, ROUNDS = 2.0, 40
"""Of Student's distribution, whose tails leave trees and changes their say; a loss that rejects them would leave the
scale to the small relief of the ground."""
LEAST_SLOPE = 0.3
SPREAD_FLOOR_M = 0.02
BLUR_TOLERANCE = 0.2
"""Relative error of the estimated blur: kernels of elevation models are no Gaussians. It was 10 to 20 % on means over
10 and 30 m of three sites, where it changed the scale by up to 7 %."""
LEAST_CORRELATION = 0.7  # below, the surfaces differ by more than noise
SYSTEMATIC = 0.025  # of the scale: growth of plants, smoothed edges


@dataclass(frozen=True, eq=False)
class HeightFit:
    """reference = offset + slope . (east, north) + scale * model, of heights about `centre`.

    Attributes:
        scale: 1 where both have the same unit and the focal length is right.
        offset_m: to be added to the model at `centre`.
        slope: (2,) by which the reference rises more towards east and north, metres per metre.
        covariance: (4, 4) of slope, offset and scale.
        centre: (3,) metres: east, north and the model's mean height.
        spread_m: robust standard deviation of what the fit leaves.
        model_relief_m, reference_relief_m: standard deviation of heights about a plane, where both are known.
        resolution_m: finest detail of the elevation model, full width at half maximum, as it fits the model best.
        blocks: number of independent blocks.
        hidden_share: of the model's outline, the part without heights: crowns, water, roofs without texture. A coarse
            elevation model averages over what is there.
    """

    scale: float
    offset_m: float
    slope: Array
    covariance: Array
    centre: Array
    spread_m: float
    model_relief_m: float
    reference_relief_m: float
    resolution_m: float
    blocks: int
    hidden_share: float = 0.0

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of the scale."""
        return float(np.sqrt(self.covariance[3, 3]))


def compare_heights(
    model: Array32, reference: Array32, grid: Grid, dsm_pixel_m: float, *, use: Mask | None = None
) -> HeightFit | None:
    """Fit the reference's heights to the model's, both (h, w) in metres on one grid, NaN where unknown.

    Args:
        model: of the registered model, with the scale that positions in plan give.
        reference: of the elevation model.
        grid: of both.
        dsm_pixel_m: of the elevation model's file: a lower bound of its blur.
        use: (h, w) pixels to compare; all by default.

    Returns:
        None where they share no area; without a scale where they share too few independent blocks for one.
    """
    model = model if use is None else np.where(use, model, np.nan).astype(np.float32)
    step = max(1, round(WORKING_M / grid.pixel_m))
    rows, columns = _extent(np.isfinite(model) & np.isfinite(reference))
    size_m = step * grid.pixel_m
    a, b = (averaged(x[rows, columns], step) for x in (model, reference))
    if min(a.shape) < 3:
        return None
    corner = grid.enu_from_px([[columns.start, rows.start]])[0]
    low, high = blur_range(reference, grid.pixel_m, dsm_pixel_m)
    blurs = [blur for blur in (0.0, *BLURS_M) if low <= blur <= high] or [low]
    smooth = blurred(b, BLUR_M / size_m)
    trials = [blurred(a, float(np.hypot(BLUR_M, blur)) / size_m) for blur in blurs]
    pairs = _Pairs.of(trials, smooth, corner, size_m)
    found = None if pairs is None else _over_blurs(pairs, np.array(blurs), size_m)
    found = found or _offset_only(a, b, corner, size_m)
    return None if found is None else replace(found, hidden_share=_hidden_share(a, b))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Positions (n, 2), the model's heights for each blur (k, n), and the reference's (n,)."""

    east_north: Array
    models: list[Array]
    target: Array

    @classmethod
    def of(cls, trials: list[Array32], smooth: Array32, corner: Array, size_m: float) -> _Pairs | None:
        known = np.isfinite(smooth) & np.isfinite(np.sum(trials, axis=0))
        if np.count_nonzero(known) < MIN_PIXELS:
            return None
        row, column = np.nonzero(known)
        east_north = corner + np.column_stack([column + 0.5, -row - 0.5]) * size_m
        return cls(east_north, [x[known].astype(np.float64) for x in trials], smooth[known].astype(np.float64))


def _over_blurs(pairs: _Pairs, blurs: Array, size_m: float) -> HeightFit | None:
    """Mean over the blurs, weighted by their likelihood: a blur that is not known is uncertainty of the scale."""
    fits = [_robust(pairs.east_north, model, pairs.target) for model in pairs.models]
    widths = np.hypot(BLUR_M, blurs)
    logs = np.array([fit.log_likelihood for fit in fits])
    independent = len(pairs.target) * size_m**2 / (4 * np.pi * (widths[int(np.argmax(logs))] ** 2 + 1))
    shares = np.exp(independent * (logs - logs.max()))
    shares /= shares.sum()
    best = int(np.argmax(shares))
    judged = _judged(fits[best], pairs.east_north, pairs.models[best], pairs.target, float(blurs[best]))
    if judged is None:
        return None
    scales = np.array([fit.solution[3] for fit in fits])
    mean = float(shares @ scales)
    low, high = max(best - 1, 0), min(best + 1, len(blurs) - 1)
    steepness = (scales[high] - scales[low]) / np.log(widths[high] / widths[low]) if high > low else 0.0
    covariance = judged.covariance.copy()
    covariance[3, 3] += float(shares @ (scales - mean) ** 2) + (BLUR_TOLERANCE * steepness) ** 2
    covariance[3, 3] += (SYSTEMATIC * mean) ** 2
    return replace(judged, scale=judged.scale + mean - float(scales[best]), covariance=covariance)


def _hidden_share(model: Array32, reference: Array32) -> float:
    """Part of the convex outline of the model's heights, where the reference has some, without heights of the model."""
    known = np.isfinite(model)
    points = cv2.findNonZero(known.astype(np.uint8))
    outline = cv2.fillConvexPoly(np.zeros(known.shape, np.uint8), cv2.convexHull(points), 1) > 0
    asked = outline & np.isfinite(reference)
    return float(1 - np.mean(known[asked])) if asked.any() else 0.0


def _offset_only(model: Array32, reference: Array32, corner: Array, size_m: float) -> HeightFit | None:
    """The median difference; slope and scale are not determined."""
    known = np.isfinite(model) & np.isfinite(reference)
    if not known.any():
        return None
    row, column = np.nonzero(known)
    middle = corner + np.array([column.mean() + 0.5, -row.mean() - 0.5]) * size_m
    off = reference[known].astype(np.float64) - model[known]
    spread = max(1.4826 * float(np.median(np.abs(off - np.median(off)))), SPREAD_FLOOR_M)
    covariance = np.diag([np.inf, np.inf, spread**2, np.inf])
    centre = np.array([*middle, float(np.median(model[known]))])
    relief = [float(np.std(x[known])) for x in (model, reference)]
    return HeightFit(
        float("nan"),
        float(np.median(off)),
        np.zeros(2),
        covariance,
        centre,
        spread,
        relief[0],
        relief[1],
        float("nan"),
        1,
    )


@dataclass(frozen=True, eq=False)
class _Robust:
    solution: Array  # slope east, slope north, offset, scale; of centred coordinates
    weights: Array
    slope: float  # mean derivative of the influence function over the mean weight: 1 for least squares
    spread: float
    log_likelihood: float  # mean per pixel


def _design(east_north: Array, model: Array) -> Array:
    return np.column_stack([east_north - east_north.mean(axis=0), np.ones(len(model)), model - model.mean()])


def _robust(east_north: Array, model: Array, target: Array) -> _Robust:
    """Maximum likelihood under Student's distribution by reweighting (Lange, Little and Taylor, JASA 1989)."""
    design = _design(east_north, model)
    balance = np.maximum(np.abs(design).max(axis=0), 1e-9)
    scaled = design / balance
    weights, variance = np.ones(len(model)), float(np.var(target)) + SPREAD_FLOOR_M**2
    solution, residual = np.zeros(4), target
    for _ in range(ROUNDS):
        normal = (scaled.T * weights) @ scaled + 1e-9 * np.eye(4)
        solution = np.linalg.solve(normal, scaled.T @ (weights * target))
        residual = target - scaled @ solution
        variance = max(float(np.mean(weights * residual**2)), SPREAD_FLOOR_M**2)
        weights = (DOF + 1) / (DOF + residual**2 / variance)
    fit = np.log1p(residual**2 / variance / DOF)
    spread = 1.4826 * float(np.median(np.abs(residual)))
    likelihood = -float(np.log(variance)) / 2 - (DOF + 1) / 2 * float(np.mean(fit))
    squared = residual**2 / variance
    derivative = (DOF + 1) * (DOF - squared) / (DOF + squared) ** 2
    slope = max(float(derivative.sum() / weights.sum()), LEAST_SLOPE)
    return _Robust(solution / balance, weights, slope, spread, likelihood)


def _judged(fit: _Robust, east_north: Array, model: Array, target: Array, blur: float) -> HeightFit | None:
    """With the covariance by jackknife, for two sizes of blocks: errors may be correlated over more than one."""
    design = _design(east_north, model)
    found = []
    for side in (1, 2):
        length = side * max(BLOCK_M, BLOCK_BLURS * float(np.hypot(BLUR_M, blur)))
        found += [one] if (one := _jackknife(design, target, fit.weights, east_north, length)) is not None else []
    if not found:
        return None
    blocks, covariance = found[0]
    growth = np.sqrt(np.max([np.diag(c) / np.diag(covariance) for _, c in found], axis=0))
    # The jackknife keeps the weights, which would change with the solution (Huber, Robust Statistics, 1981).
    covariance = covariance * np.outer(growth, growth) / fit.slope**2
    scale = float(fit.solution[3])
    off_plane = [_off_plane(design, values, fit.weights) for values in (model, target)]
    covariance[3, 3] += (scale * _dilution(off_plane, fit.weights)) ** 2
    relief = [float(np.sqrt(np.average(values**2, weights=fit.weights))) for values in off_plane]
    slope, offset = fit.solution[:2], fit.solution[2] - model.mean()
    centre = np.array([*east_north.mean(axis=0), model.mean()])
    return HeightFit(
        scale,
        float(offset),
        slope,
        covariance,
        centre,
        fit.spread,
        relief[0],
        relief[1],
        2.355 * max(blur, BLUR_M / 2),
        blocks,
    )


def _jackknife(
    design: Array, target: Array, weights: Array, east_north: Array, length_m: float
) -> tuple[int, Array] | None:
    """Number of blocks and covariance (4, 4) by leaving out each; None for too few blocks."""
    cells = np.floor(east_north / length_m).astype(np.int64)
    _, block = np.unique(cells, axis=0, return_inverse=True)
    block = block.ravel()
    n = int(block.max()) + 1
    used = np.bincount(block, weights=weights, minlength=n) > 0
    if np.count_nonzero(used) < MIN_BLOCKS:
        return None
    weighted = design * weights[:, None]
    normals, rights = np.zeros((n, 4, 4)), np.zeros((n, 4))
    for i in range(4):
        rights[:, i] = np.bincount(block, weights=weighted[:, i] * target, minlength=n)
        for j in range(4):
            normals[:, i, j] = np.bincount(block, weights=weighted[:, i] * design[:, j], minlength=n)
    normal, right = normals.sum(axis=0), rights.sum(axis=0)
    guard = 1e-9 * np.diag(np.diag(normal)) + 1e-12 * np.eye(4)
    without = [np.linalg.solve(normal - normals[k] + guard, right - rights[k]) for k in np.flatnonzero(used)]
    n = len(without)
    off = np.array(without) - np.mean(without, axis=0)
    return n, (n - 1) / n * off.T @ off


def _dilution(off_plane: list[Array], weights: Array) -> float:
    """Relative uncertainty of the scale by noise of the model's own heights, which flattens a regression on them.

    The inverse regression is too steep by as much as the correlation of both lies below 1: half of that.
    """
    (mm, mt), (_, tt) = np.cov(off_plane, aweights=weights)
    r = mt / np.sqrt(mm * tt) if mm > 0 and tt > 0 else 0.0
    return float(np.log(1 / r) / 2) if r >= LEAST_CORRELATION else 0.0


def _off_plane(design: Array, values: Array, weights: Array) -> Array:
    root = np.sqrt(weights)
    plane = design[:, :3]
    return np.asarray(values - plane @ np.linalg.lstsq(plane * root[:, None], values * root, rcond=None)[0])


def _extent(known: Mask) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
