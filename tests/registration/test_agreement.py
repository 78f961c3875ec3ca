# SPDX-License-Identifier: Apache-2.0
"""Cells of the map are counted once, and only where the model and the map are."""

from __future__ import annotations

import numpy as np

from skymoor.registration.agreement import count_cells

MAP_FROM_MODEL = np.array([[0.5, 0.0, 20.0], [0.0, 0.5, 40.0]])  # a render of 200 x 100 covers 100 x 50 of the map


def counted(px: np.ndarray, inliers: np.ndarray, *, on_map: np.ndarray | None = None) -> tuple[int, int]:
    covers = np.ones((100, 200), bool)
    everywhere = np.ones((120, 160), bool)
    found = count_cells(covers, everywhere if on_map is None else on_map, MAP_FROM_MODEL, px, inliers, 10.0)
    return found.agreeing, found.covered


def cell(column: int, row: int, n: int = 4) -> np.ndarray:
    return np.column_stack([np.linspace(1, 9, n) + 10 * column, np.linspace(1, 9, n) + 10 * row])


def test_cells_that_the_model_covers() -> None:
    assert counted(np.zeros((0, 2)), np.zeros(0, bool)) == (0, 50)
    half = np.ones((120, 160), bool)
    half[:, :70] = False
    assert counted(np.zeros((0, 2)), np.zeros(0, bool), on_map=half) == (0, 25)


def test_a_cell_agrees_where_most_of_its_matches_do() -> None:
    px = np.vstack([cell(3, 5), cell(4, 5), cell(5, 5), cell(6, 5, n=2), cell(0, 0)])
    inliers = np.array([True] * 4 + [True] * 3 + [False] + [True] * 2 + [False] * 2 + [True] * 2 + [True] * 4)
    # All, three of four, a draw, too few matches, and beside the model.
    assert counted(px, inliers) == (2, 50)


def test_matches_beside_the_map_count_nowhere() -> None:
    px = np.array([[-1.0, 50.0], [170.0, 50.0], [50.0, 130.0]] * 4)
    assert counted(px, np.ones(len(px), bool)) == (0, 50)
