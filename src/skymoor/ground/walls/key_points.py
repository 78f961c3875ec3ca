# SPDX-License-Identifier: Apache-2.0
"""Key points of walls that agree between their orthophotos from the ground and from the air.

What orders places: learned key points hardly match between walls that resemble each other in floors and edges only,
where the hand-made channels agree a little anywhere. Of the matches of a wall those count that are displaced
alike, by no more than a hypothesis may still be off.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from skymoor.ground.walls.facade_pairs import FacadePair
from skymoor.match import PointMatcher
from skymoor.types import Array, Raster

ENLARGED = 4  # networks are trained on photos, where windows have more than these orthophotos' 5 to 10 pixels
REACH_M = 3.0  # that a hypothesis may be off
ALIKE_M = 0.6  # the matcher's errors, and depth before or behind the plane of the wall
CELL_M = 1.0  # key points nearer to each other show the same thing
FEWEST_PX = 100


def agreeing_cells(pairs: Sequence[FacadePair], matcher: PointMatcher) -> int:
    """Squares of a metre on the walls with matches that are displaced alike, over all walls.

    Args:
        pairs: orthophotos of walls at a hypothesis.
        matcher: of key points.
    """
    cells = 0
    for pair in pairs:
        if np.count_nonzero(pair.ground.mask & pair.airborne.mask) < FEWEST_PX:
            continue
        of_ground, of_airborne = matcher(_enlarged(pair.ground), _enlarged(pair.airborne))
        metres = pair.facade.pixel_m / ENLARGED
        cells += _cells_displaced_alike(of_ground * metres, (of_airborne - of_ground) * metres)
    return cells


def _cells_displaced_alike(at_m: Array, displaced_m: Array) -> int:
    """Cells of the places (n, 2) whose displacements (n, 2) are near that one which most are near to."""
    within = np.linalg.norm(displaced_m, axis=1) < REACH_M
    at_m, displaced_m = at_m[within], displaced_m[within]
    if not len(at_m):
        return 0
    near = np.linalg.norm(displaced_m[:, None] - displaced_m[None], axis=2) < ALIKE_M
    most = near[near.sum(axis=1).argmax()]
    return len(np.unique(np.floor(at_m[most] / CELL_M), axis=0))


def _enlarged(raster: Raster) -> Raster:
    size = (raster.mask.shape[1] * ENLARGED, raster.mask.shape[0] * ENLARGED)
    mask = cv2.resize(raster.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return Raster(np.asarray(cv2.resize(raster.rgb, size, interpolation=cv2.INTER_CUBIC), np.uint8), mask)
