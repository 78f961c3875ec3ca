# SPDX-License-Identifier: Apache-2.0
"""Selection of photo pairs to match.

Exhaustive matching grows with the square of the number of photos. Large features are few and the most repeatable,
so the number of mutual nearest neighbours among each photo's largest ones indicates which photos overlap: preemptive
matching (Wu, "Towards linear-time incremental structure from motion", 3DV 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array32, Progress, no_progress

BLOCK_PHOTOS = 64  # compared with one photo in one matrix product: large enough for BLAS, small enough for memory


def exhaustive_pairs(n: int) -> list[tuple[int, int]]:
    """All pairs of n photos."""
    return list(combinations(range(n), 2))


def preemptive_pairs(
    descriptors: Sequence[Array32], *, neighbours: int, min_mutual: int = 3, progress: Progress = no_progress
) -> list[tuple[int, int]]:
    """Pairs (i < j) in which one photo is among the other's `neighbours` most similar.

    Args:
        descriptors: per photo (m, d), unit length, of its largest features only; a few hundred are enough.
        neighbours: how many partners a photo keeps.
        min_mutual: pairs with fewer mutual nearest neighbours are ignored.
        progress: called per photo.
    """
    n = len(descriptors)
    votes = np.zeros((n, n), np.int32)
    photos = [np.ascontiguousarray(one, np.float32) for one in descriptors]
    for i, photo in enumerate(photos):
        others = [j for j in range(i + 1, n) if len(photos[j])] if len(photo) else []
        for start in range(0, len(others), BLOCK_PHOTOS):
            block = others[start : start + BLOCK_PHOTOS]
            similarity = photo @ np.concatenate([photos[j] for j in block]).T
            ends = np.cumsum([len(photos[j]) for j in block])[:-1]
            for j, part in zip(block, np.split(similarity, ends, axis=1), strict=True):
                votes[i, j] = votes[j, i] = _mutual(part)
        progress(i + 1, n)
    return pairs_from_votes(votes, neighbours=neighbours, min_votes=min_mutual)


def pairs_from_votes(votes: NDArray[np.int32], *, neighbours: int, min_votes: int) -> list[tuple[int, int]]:
    """Keep each photo's best partners of a symmetric (n, n) table of votes."""
    pairs: set[tuple[int, int]] = set()
    for i, row in enumerate(votes):
        best = np.argsort(-row, kind="stable")[:neighbours]
        pairs.update((min(i, int(j)), max(i, int(j))) for j in best if row[j] >= min_votes)
    return sorted(pairs)


def _mutual(similarity: Array32, ratio: float = 0.92) -> int:
    """Mutual nearest neighbours whose angle is clearly below that to the second nearest."""
    if min(similarity.shape) < 2:
        return 0
    rows = np.arange(len(similarity))
    forward, backward = similarity.argmax(axis=1), similarity.argmax(axis=0)
    best = similarity[rows, forward]
    others = similarity.copy()
    others[rows, forward] = -np.inf
    second = others.max(axis=1)
    nearest, next_nearest = (np.arccos(np.clip(cosine, -1, 1)) for cosine in (best, second))
    return int(np.count_nonzero((backward[forward] == rows) & (nearest < ratio * next_nearest)))
