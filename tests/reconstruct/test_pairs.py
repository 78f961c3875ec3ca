# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.reconstruct import pairs
from skymoor.reconstruct.pairs import exhaustive_pairs, pairs_from_votes, preemptive_pairs, proposed_pairs

Array32 = NDArray[np.float32]


def unit(rows: NDArray[np.float64]) -> Array32:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


def strip(n: int, *, step: int, window: int, noise: float = 0.02) -> list[Array32]:
    """Photos along a strip: each holds `window` features of a row, the next one begins `step` features later."""
    rng = np.random.default_rng(0)
    world = unit(rng.normal(size=(n * step + window, 128)))
    photos = [world[k * step : k * step + window] + noise * rng.normal(size=(window, 128)) for k in range(n)]
    return [unit(rng.permutation(photo)) for photo in photos]


def test_exhaustive_is_every_pair_once() -> None:
    assert exhaustive_pairs(4) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert exhaustive_pairs(1) == []


def test_votes_keep_the_best_of_either_side() -> None:
    votes = np.array([[0, 9, 5, 1], [9, 0, 7, 2], [5, 7, 0, 0], [1, 2, 0, 0]], np.int32)
    # Photo 3 chooses photo 1, though photo 1 has a better one: a pair needs one side only.
    assert pairs_from_votes(votes, neighbours=1, min_votes=1) == [(0, 1), (1, 2), (1, 3)]
    assert pairs_from_votes(votes, neighbours=1, min_votes=3) == [(0, 1), (1, 2)]
    assert pairs_from_votes(votes, neighbours=3, min_votes=1) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3)]
    assert pairs_from_votes(np.zeros((3, 3), np.int32), neighbours=2, min_votes=1) == []


def test_overlapping_photos_find_each_other() -> None:
    photos = strip(10, step=40, window=100)  # 60 common features with the next photo, 20 with the one after
    # Photos at the ends have two partners to one side, and those are the nearest ones.
    near = [(a, b) for a in range(10) for b in (a + 1, a + 2) if b < 10]
    assert set(preemptive_pairs(photos, neighbours=2)) == {(k, k + 1) for k in range(9)} | {(0, 2), (7, 9)}
    assert preemptive_pairs(photos, neighbours=9, min_mutual=12) == near


def test_votes_of_chance_are_far_below_those_of_an_overlap() -> None:
    rng = np.random.default_rng(2)
    photos = [*strip(3, step=40, window=100), *(unit(rng.normal(size=(100, 128))) for _ in range(3))]
    assert preemptive_pairs(photos, neighbours=5, min_mutual=12) == [(0, 1), (0, 2), (1, 2)]
    assert preemptive_pairs(photos, neighbours=5, min_mutual=50) == [(0, 1), (1, 2)]


def test_photos_without_features_are_left_out_and_progress_ends() -> None:
    photos = strip(4, step=30, window=100)
    photos[2] = np.zeros((0, 64), np.float32)
    photos[3] = photos[3][:1]
    steps: list[tuple[int, int]] = []
    assert preemptive_pairs(
        photos, neighbours=3, min_mutual=30, progress=lambda done, of: steps.append((done, of))
    ) == [(0, 1)]
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]


class TestIndex:
    """Large sets: an index proposes what is compared."""

    def test_the_pairs_of_a_strip_are_those_of_all_comparisons(self) -> None:
        photos = strip(70, step=40, window=100)
        exact = preemptive_pairs(photos, neighbours=4, min_mutual=12, all_below=len(photos))
        assert preemptive_pairs(photos, neighbours=4, min_mutual=12, all_below=len(photos) - 1) == exact
        assert len(exact) == 69 + 68

    def test_a_few_are_proposed_for_each(self) -> None:
        photos = strip(60, step=40, window=100)
        proposed = proposed_pairs(photos, 6)
        assert (proposed == proposed.T).all() and not proposed.diagonal().any()
        assert proposed.sum(axis=1).min() >= 6 and proposed.sum(axis=1).mean() < 9
        assert all(proposed[k, k + 1] for k in range(59))
        np.testing.assert_array_equal(proposed, proposed_pairs(photos, 6))

    def test_what_the_index_misses_is_found_over_a_common_partner(self, monkeypatch: pytest.MonkeyPatch) -> None:
        photos = strip(12, step=20, window=100)
        chain = np.eye(12, k=1, dtype=bool) | np.eye(12, k=-1, dtype=bool)
        monkeypatch.setattr(pairs, "proposed_pairs", lambda *_: chain)
        steps: list[tuple[int, int]] = []
        found = preemptive_pairs(
            photos, neighbours=11, min_mutual=12, all_below=3, progress=lambda done, of: steps.append((done, of))
        )
        assert {(k, k + 2) for k in range(10)} <= set(found)
        assert steps == [(k, 24) for k in range(1, 25)]

    def test_photos_without_features(self) -> None:
        none = np.zeros((0, 128), np.float32)
        assert preemptive_pairs([none] * 5, neighbours=3, all_below=3) == []
        photos = [none, *strip(4, step=30, window=100)]
        found = preemptive_pairs(photos, neighbours=2, min_mutual=50, all_below=3)
        assert found == [(1, 2), (2, 3), (3, 4)]
