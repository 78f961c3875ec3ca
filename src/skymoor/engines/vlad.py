# SPDX-License-Identifier: Apache-2.0
"""VLAD: aggregation of an image's local descriptors into one vector.

Jegou, Douze, Schmid and Perez, Aggregating local descriptors into a compact image representation, CVPR 2010, with the
intra-normalisation of Arandjelovic and Zisserman, All about VLAD, CVPR 2013, which limits the weight of repetitive
structures.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.cluster.vq import kmeans2

from skymoor.errors import TooFewMatches
from skymoor.types import Array32

ITERATIONS = 25


def vocabulary(features: Array32, clusters: int, *, rng: np.random.Generator) -> Array32:
    """Centres (k, d) of k-means on descriptors (n, d), seeded by k-means++ (Arthur and Vassilvitskii 2007).

    k is `clusters`, or fewer if there are fewer distinct descriptors.

    Raises:
        TooFewMatches: there are fewer descriptors than clusters.
    """
    if len(features) < clusters:
        raise TooFewMatches(f"{len(features)} local descriptors are too few for a vocabulary of {clusters} words")
    start = _seeds(features, clusters, rng)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "One of the clusters is empty")
        centres, words = kmeans2(features, start, iter=ITERATIONS, minit="matrix")
    return np.asarray(centres[np.unique(words)], np.float32)


def vlad(features: Array32, centres: Array32) -> Array32:
    """VLAD vector (k * d,) of length 1 of an image's descriptors (n, d), with a vocabulary (k, d).

    Each descriptor is assigned to the nearest word; residuals are summed per word. All zero without descriptors.
    """
    nearest = np.argmax(features @ centres.T - 0.5 * np.sum(centres**2, axis=1), axis=1)
    sums = np.zeros_like(centres)
    np.add.at(sums, nearest, features - centres[nearest])
    return unit(unit(sums).ravel())


def unit(rows: Array32) -> Array32:
    """Vectors (..., d) scaled to length 1; zero vectors stay zero."""
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(np.divide(rows, length, out=np.zeros_like(rows), where=length > 1e-12), np.float32)


def _seeds(features: Array32, count: int, rng: np.random.Generator) -> Array32:
    """At most `count` rows, each drawn with probability proportional to its squared distance from those before."""
    chosen = [int(rng.integers(len(features)))]
    squared_distances = np.full(len(features), np.inf)
    while len(chosen) < count:
        squared_distances = np.minimum(
            squared_distances, np.sum((features - features[chosen[-1]]) ** 2, axis=1, dtype=np.float64)
        )
        if not squared_distances.any():
            break
        chosen.append(int(rng.choice(len(features), p=squared_distances / squared_distances.sum())))
    return features[chosen]
