# SPDX-License-Identifier: Apache-2.0
"""Exposure compensation: gains of photos from surface cells that several of them observe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array


def exposure_log_gains(
    image: NDArray[np.intp], cell: NDArray[np.intp], log_rgb: Array, n_images: int, *, rounds: int = 5
) -> Array:
    """Log gains (n_images, 3) of photos, mean 0, such that log_rgb = gain of the photo + colour of the cell.

    Args:
        image, cell: (n,) photo and surface cell of each observation.
        log_rgb: (n, 3) logarithm of the observed colour.
        n_images: number of photos; those without a shared cell get 0.
        rounds: iterations of Huber reweighting, against shadows, moving objects and reflections.

    Least squares with the cells' colours eliminated: a small system in the photos' gains remains.
    """
    gains = np.zeros((n_images, 3))
    if not len(image):
        return gains
    _, cell = np.unique(cell, return_inverse=True)
    for channel in range(3):
        values, weights = log_rgb[:, channel], np.ones(len(image))
        for _ in range(rounds):
            gain = _solve(image, cell, values, weights, n_images)
            total = np.bincount(cell, weights)
            colour = np.bincount(cell, weights * (values - gain[image])) / np.maximum(total, 1e-12)
            residual = np.abs(values - gain[image] - colour[cell])
            limit = max(1.5 * float(np.median(residual)), 1e-3)
            weights = np.minimum(1.0, limit / np.maximum(residual, 1e-12))
        gains[:, channel] = gain
    return gains


def _solve(
    image: NDArray[np.intp], cell: NDArray[np.intp], values: Array, weights: Array, n_images: int
) -> NDArray[np.float64]:
    from scipy.sparse import csr_matrix

    shape = (n_images, int(cell.max()) + 1)
    graph = csr_matrix((weights, (image, cell)), shape=shape)
    weighted = csr_matrix((weights * values, (image, cell)), shape=shape)
    per_cell = np.maximum(np.asarray(graph.sum(axis=0)).ravel(), 1e-12)
    normal = np.diag(np.asarray(graph.sum(axis=1)).ravel()) - (graph.multiply(1 / per_cell) @ graph.T).toarray()
    right = np.asarray(weighted.sum(axis=1)).ravel() - graph @ (np.asarray(weighted.sum(axis=0)).ravel() / per_cell)
    # The mean gain is undetermined: the minimum-norm solution leaves unconnected photos at 0.
    gain = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    return np.asarray(gain - gain.mean())
