# SPDX-License-Identifier: Apache-2.0
"""Which pairs of photos are worth matching.

Exhaustive matching grows with the square of the number of photos. Large features are few and the most repeatable,
so the number of mutual nearest neighbours among each photo's largest ones tells which photos overlap: preemptive
matching (Wu, "Towards linear-time incremental structure from motion", 3DV 2013). No vocabulary, no order of flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch
from numpy.typing import NDArray

from skymoor.types import Array32, Progress, no_progress


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
        min_mutual: fewer mutual nearest neighbours than this are chance.
        progress: called per photo.
    """
    n = len(descriptors)
    votes = np.zeros((n, n), np.int32)
    tensors = [torch.from_numpy(np.ascontiguousarray(d)) for d in descriptors]
    for i in range(n):
        others = [j for j in range(i + 1, n) if len(tensors[j])]
        if others and len(tensors[i]):
            sizes = [len(tensors[j]) for j in others]
            similarity = tensors[i] @ torch.cat([tensors[j] for j in others]).T
            for j, block in zip(others, torch.split(similarity, sizes, dim=1), strict=True):
                votes[i, j] = votes[j, i] = _mutual(block)
        progress(i + 1, n)
    return pairs_from_votes(votes, neighbours=neighbours, min_votes=min_mutual)


def pairs_from_votes(votes: NDArray[np.int32], *, neighbours: int, min_votes: int) -> list[tuple[int, int]]:
    """Keep each photo's best partners of a symmetric (n, n) table of votes."""
    pairs: set[tuple[int, int]] = set()
    for i, row in enumerate(votes):
        best = np.argsort(-row, kind="stable")[:neighbours]
        pairs.update((min(i, int(j)), max(i, int(j))) for j in best if row[j] >= min_votes)
    return sorted(pairs)


def _mutual(similarity: torch.Tensor, ratio: float = 0.92) -> int:
    """Mutual nearest neighbours whose angle is clearly below that to the second nearest."""
    if min(similarity.shape) < 2:
        return 0
    best, forward = similarity.topk(2, dim=1)
    backward = similarity.argmax(dim=0)
    mutual = backward[forward[:, 0]] == torch.arange(len(forward))
    angle = torch.arccos(best.clamp(-1, 1))
    return int((mutual & (angle[:, 0] < ratio * angle[:, 1])).sum())
