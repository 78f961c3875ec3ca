# SPDX-License-Identifier: Apache-2.0
"""Many local descriptions of an image to one vector: VLAD.

Jegou, Douze, Schmid and Perez, Aggregating local descriptors into a compact image representation, CVPR 2010; each
cluster's part is normalised for itself as in Arandjelovic and Zisserman, All about VLAD, CVPR 2013, so that what
repeats in an image does not outvote the rest.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.cluster.vq import kmeans2

from skymoor.errors import TooFewMatches
from skymoor.types import Array32

ITERATIONS = 25


def vocabulary(features: Array32, clusters: int, *, rng: np.random.Generator) -> Array32:
    """Centres (k, d) of k-means on descriptions (n, d), started far apart (k-means++, Arthur and Vassilvitskii 2007).

    `k` is `clusters`, or fewer if there are not so many different descriptions.

    Raises:
        TooFewMatches: there are fewer descriptions than clusters.
    """
    if len(features) < clusters:
        raise TooFewMatches(f"{len(features)} local descriptions make no vocabulary of {clusters} words")
    start = _far_apart(features, clusters, rng)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "One of the clusters is empty")
        centres, words = kmeans2(features, start, iter=ITERATIONS, minit="matrix")
    return np.asarray(centres[np.unique(words)], np.float32)


def vlad(features: Array32, centres: Array32) -> Array32:
    """One vector (k * d,) of length 1 for the descriptions (n, d) of an image, with a vocabulary (k, d).

    Each description goes to the nearest word; what it differs from it is summed per word. All zero for no description.
    """
    nearest = np.argmax(features @ centres.T - 0.5 * np.sum(centres**2, axis=1), axis=1)
    sums = np.zeros_like(centres)
    np.add.at(sums, nearest, features - centres[nearest])
    return unit(unit(sums).ravel())


def unit(rows: Array32) -> Array32:
    """Vectors (..., d) of length 1; those without length stay 0."""
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(np.divide(rows, length, out=np.zeros_like(rows), where=length > 1e-12), np.float32)


def _far_apart(features: Array32, count: int, rng: np.random.Generator) -> Array32:
    """At most so many of the rows: each is drawn by its squared distance from those drawn before."""
    chosen = [int(rng.integers(len(features)))]
    gaps = np.full(len(features), np.inf)
    while len(chosen) < count:
        gaps = np.minimum(gaps, np.sum((features - features[chosen[-1]]) ** 2, axis=1, dtype=np.float64))
        if not gaps.any():
            break
        chosen.append(int(rng.choice(len(features), p=gaps / gaps.sum())))
    return features[chosen]
