# SPDX-License-Identifier: Apache-2.0
"""Selection of photo pairs to match.

Exhaustive matching grows with the square of the number of photos. Large features are few and the most repeatable,
so the number of mutual nearest neighbours among each photo's largest ones indicates which photos overlap: preemptive
matching (Wu, "Towards linear-time incremental structure from motion", 3DV 2013). That itself compares all pairs; in
large sets an index of one vector per photo (VLAD) proposes which (docs/decisions/0032).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.vlad import vlad, vocabulary
from skymoor.types import Array32, Mask, Progress, no_progress

ALL_BELOW = 100
"""Photos up to which all pairs are compared, in half a minute; beyond, that takes two hours for 2000."""
PROPOSED, PARTNERS = 40, 8
"""Photos that the index proposes for each, and partners of each whose partners are compared as well."""
WORDS, PER_WORD = 64, 200  # of the vocabulary, and features from which a word is learned
BLOCK_PHOTOS = 64  # compared with one photo in one matrix product: large enough for BLAS, small enough for memory


def exhaustive_pairs(n: int) -> list[tuple[int, int]]:
    """All pairs of n photos."""
    return list(combinations(range(n), 2))


def preemptive_pairs(
    descriptors: Sequence[Array32],
    *,
    neighbours: int,
    min_mutual: int = 3,
    all_below: int = ALL_BELOW,
    progress: Progress = no_progress,
) -> list[tuple[int, int]]:
    """Pairs (i < j) in which one photo is among the other's `neighbours` most similar.

    Args:
        descriptors: per photo (m, d), unit length, of its largest features only; a few hundred are enough.
        neighbours: how many partners a photo keeps.
        min_mutual: pairs with fewer mutual nearest neighbours are ignored.
        all_below: sets of more photos compare those alone that an index proposes.
        progress: called per photo; twice where there is an index.
    """
    n = len(descriptors)
    votes = np.zeros((n, n), np.int32)
    photos = [np.ascontiguousarray(one, np.float32) for one in descriptors]
    if n <= all_below:
        _vote(votes, photos, ~np.eye(n, dtype=bool), lambda done: progress(done, n))
        return pairs_from_votes(votes, neighbours=neighbours, min_votes=min_mutual)
    proposed = proposed_pairs(photos, PROPOSED)
    _vote(votes, photos, proposed, lambda done: progress(done, 2 * n))
    partners = np.zeros((n, n), np.float32)
    for i, j in pairs_from_votes(votes, neighbours=PARTNERS, min_votes=2 * min_mutual):
        partners[i, j] = partners[j, i] = 1.0
    # What overlaps the same photo often overlaps; this finds most of what the index has missed.
    of_partners = (partners @ partners > 0) & ~proposed
    _vote(votes, photos, of_partners, lambda done: progress(n + done, 2 * n))
    return pairs_from_votes(votes, neighbours=neighbours, min_votes=min_mutual)


def proposed_pairs(photos: Sequence[Array32], count: int) -> Mask:
    """Mask (n, n), symmetric, of the `count` photos most similar to each as a whole (VLAD).

    The vocabulary is that of the photos themselves; it is drawn with a fixed seed.
    """
    rng = np.random.default_rng(0)
    n, features = len(photos), np.concatenate(photos)
    mask = np.zeros((n, n), bool)
    if not len(features):
        return mask
    sample = features[rng.permutation(len(features))[: WORDS * PER_WORD]]
    centres = vocabulary(sample, min(WORDS, len(sample)), rng=rng)
    vectors = np.stack([vlad(photo, centres) for photo in photos])
    similarity = vectors @ vectors.T
    np.fill_diagonal(similarity, -np.inf)
    best = np.argsort(-similarity, axis=1, kind="stable")[:, :count]
    mask[np.arange(n)[:, None], best] = True
    np.fill_diagonal(mask, val=False)
    return mask | mask.T


def _vote(votes: NDArray[np.int32], photos: Sequence[Array32], wanted: Mask, report: Callable[[int], None]) -> None:
    """Enter the numbers of mutual nearest neighbours of the `wanted` pairs into both triangles of `votes` (n, n)."""
    for i, photo in enumerate(photos):
        others = [j for j in np.flatnonzero(wanted[i]).tolist() if j > i and len(photos[j])] if len(photo) else []
        for start in range(0, len(others), BLOCK_PHOTOS):
            block = others[start : start + BLOCK_PHOTOS]
            similarity = photo @ np.concatenate([photos[j] for j in block]).T
            ends = np.cumsum([len(photos[j]) for j in block])[:-1]
            for j, part in zip(block, np.split(similarity, ends, axis=1), strict=True):
                votes[i, j] = votes[j, i] = _mutual(part)
        report(i + 1)


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
