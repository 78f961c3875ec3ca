# SPDX-License-Identifier: Apache-2.0
"""Gains that bring all photos to one exposure, from places that several of them show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array


def exposure_log_gains(
    image: NDArray[np.intp], place: NDArray[np.intp], log_rgb: Array, n_images: int, *, rounds: int = 5
) -> Array:
    """Log gains (n_images, 3) of photos, mean 0, such that log_rgb = gain of the photo + colour of the place.

    Args:
        image, place: (n,) which photo shows which place.
        log_rgb: (n, 3) logarithm of what it shows.
        n_images: photos in all; those that share no place with others get 0.
        rounds: of reweighting (Huber): shadows, cars and glints are no exposure.

    Least squares with the places eliminated, which leaves one small system of the photos.
    """
    gains = np.zeros((n_images, 3))
    if not len(image):
        return gains
    _, place = np.unique(place, return_inverse=True)
    for channel in range(3):
        values, weights = log_rgb[:, channel], np.ones(len(image))
        for _ in range(rounds):
            gain = _solve(image, place, values, weights, n_images)
            total = np.bincount(place, weights)
            colour = np.bincount(place, weights * (values - gain[image])) / np.maximum(total, 1e-12)
            residual = np.abs(values - gain[image] - colour[place])
            limit = max(1.5 * float(np.median(residual)), 1e-3)
            weights = np.minimum(1.0, limit / np.maximum(residual, 1e-12))
        gains[:, channel] = gain
    return gains


def _solve(
    image: NDArray[np.intp], place: NDArray[np.intp], values: Array, weights: Array, n_images: int
) -> NDArray[np.float64]:
    from scipy.sparse import csr_matrix

    shape = (n_images, int(place.max()) + 1)
    seen = csr_matrix((weights, (image, place)), shape=shape)
    shown = csr_matrix((weights * values, (image, place)), shape=shape)
    per_place = np.maximum(np.asarray(seen.sum(axis=0)).ravel(), 1e-12)
    normal = np.diag(np.asarray(seen.sum(axis=1)).ravel()) - (seen.multiply(1 / per_place) @ seen.T).toarray()
    right = np.asarray(shown.sum(axis=1)).ravel() - seen @ (np.asarray(shown.sum(axis=0)).ravel() / per_place)
    # The mean gain is free: among all solutions take the smallest, which leaves photos without partners at 0.
    gain = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    return np.asarray(gain - gain.mean())
