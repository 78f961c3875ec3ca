# SPDX-License-Identifier: Apache-2.0
"""Fusion of several depths per pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array32


def fuse_depths(
    depths: Array32, sigmas: Array32, *, min_views: int, tolerance_ratio: float = 0.01, gate: float = 3.0
) -> tuple[Array32, Array32, NDArray[np.uint8]]:
    """The depth that most partners agree on, averaged by weight.

    Args:
        depths: (k, h, w), NaN where a partner has no depth.
        sigmas: (k, h, w), standard deviations.
        min_views: with fewer agreeing partners the result is NaN.
        tolerance_ratio: two depths agree within this share of the depth at most ...
        gate: ... and within this many standard deviations.

    Returns:
        depth (h, w), sigma (h, w), and the number of agreeing partners (h, w). Sigma is not below the spread of the
        agreeing depths, and falls with two measurements at best: partners share their errors.
    """
    k = len(depths)
    best_count = np.zeros(depths.shape[1:], np.uint8)
    best_depth = np.full(depths.shape[1:], np.nan, np.float32)
    best_sigma = np.full(depths.shape[1:], np.nan, np.float32)
    with np.errstate(invalid="ignore"):
        for i in range(k):
            limit = np.minimum(tolerance_ratio * depths[i], gate * np.hypot(sigmas[i], sigmas))
            limit = np.maximum(limit, 0.25 * tolerance_ratio * depths[i])
            agree = np.abs(depths - depths[i]) <= limit
            count = agree.sum(axis=0).astype(np.uint8)
            weights = np.where(agree, 1 / sigmas**2, 0)
            total = weights.sum(axis=0)
            mean = np.where(agree, weights * depths, 0).sum(axis=0) / total
            spread = np.sqrt(np.where(agree, weights * (depths - mean) ** 2, 0).sum(axis=0) / total)
            sigma = np.maximum(np.where(agree, sigmas, np.inf).min(axis=0) / np.sqrt(2), spread)
            better = (count > best_count) | ((count == best_count) & (sigma < best_sigma))
            better &= count >= min_views
            best_count = np.where(better, count, best_count)
            best_depth = np.where(better, mean, best_depth).astype(np.float32)
            best_sigma = np.where(better, sigma, best_sigma).astype(np.float32)
    return best_depth, best_sigma, best_count
