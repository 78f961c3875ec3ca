# SPDX-License-Identifier: Apache-2.0
"""How much of what a model covers agrees with the map in plan, counted in independent cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Mask

MIN_MATCHES = 3  # of a cell
MIN_COVER = 0.5  # share of a cell that the model covers


@dataclass(frozen=True)
class Agreement:
    """Cells of the map that the model covers, and those of them where most matches agree with its transform.

    Matches within a cell repeat each other, and the share of agreeing *matches* does not tell a right place from a
    wrong one: at a wrong place few matches survive the cyclic test, and these may well agree.
    """

    agreeing: int
    covered: int


def count_cells(
    covers: Mask, on_map: Mask, map_from_model: Array, px: Array, inliers: Mask, cell_px: float
) -> Agreement:
    """Count the cells.

    Args:
        covers: (h, w) pixels of the model's render that show something.
        on_map: (H, W) pixels of the map with data.
        map_from_model: (2, 3) affine from pixels of the render to those of the map.
        px: (n, 2) pixels of the matches on the map.
        inliers: (n,) whether they agree.
        cell_px: side of a cell in pixels of the map; errors of matches are correlated within.
    """
    height, width = on_map.shape
    warped = cv2.warpAffine(covers.astype(np.uint8), map_from_model, (width, height), flags=cv2.INTER_NEAREST) > 0
    columns = int(np.ceil(width / cell_px))
    n_cells = columns * int(np.ceil(height / cell_px))

    def cell_of(u: NDArray[Any], v: NDArray[Any]) -> NDArray[np.int64]:
        return np.floor(v / cell_px).astype(np.int64) * columns + np.floor(u / cell_px).astype(np.int64)

    rows, cols = np.nonzero(warped & on_map)
    area = np.bincount(cell_of(cols + 0.5, rows + 0.5), minlength=n_cells)
    covered = area >= MIN_COVER * cell_px**2
    inside = (px >= 0).all(axis=1) & (px[:, 0] < width) & (px[:, 1] < height)
    cells = cell_of(*px[inside].T)
    matches = np.bincount(cells, minlength=n_cells)
    agree = np.bincount(cells, weights=inliers[inside].astype(np.float64), minlength=n_cells)
    agreeing = covered & (matches >= MIN_MATCHES) & (2 * agree > matches)
    return Agreement(int(agreeing.sum()), int(covered.sum()))
