# SPDX-License-Identifier: Apache-2.0
"""Key points that agree between orthophotos of walls: known displacements in, the places that agree out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.ground.wall_planes import Wall
from skymoor.ground.walls.facade_pairs import FacadePair
from skymoor.ground.walls.facades import Facade
from skymoor.ground.walls.key_points import ENLARGED, agreeing_cells
from skymoor.types import Raster

Array = NDArray[np.float64]
PIXEL_M = 0.2
PX_PER_M = ENLARGED / PIXEL_M


def pair(known: bool = True) -> FacadePair:
    """A wall of 12 by 6 metres."""
    shape = (int(6 / PIXEL_M), int(12 / PIXEL_M))
    image = Raster(np.full((*shape, 3), 90, np.uint8), np.full(shape, known))
    wall = Wall(np.array([1.0, 0.0]), 0.0, 0.0, 12.0, 0.0, 6.0, 72.0)
    return FacadePair(Facade(wall, image, PIXEL_M, 0.0, 6.0), image, image, np.zeros(2))


def agreeing(at_m: Array, displaced_m: Array, *, walls: int = 1) -> int:
    """Cells that agree where a matcher joins these places."""

    def matcher(a: Raster, b: Raster) -> tuple[Array, Array]:
        assert a.mask.shape == b.mask.shape == (ENLARGED * 30, ENLARGED * 60)
        return at_m * PX_PER_M, (at_m + displaced_m) * PX_PER_M

    return agreeing_cells([pair()] * walls, matcher)


def every_metre(n: int) -> Array:
    """Middles of n cells."""
    return np.array([(column + 0.5, row + 0.5) for row in range(6) for column in range(12)])[:n]


@pytest.mark.parametrize(("off_m", "expected"), [((0.0, 0.0), 40), ((1.8, -1.1), 40), ((2.9, 2.9), 0)])
def test_an_offset_is_borne_up_to_what_a_pose_may_be_off(off_m: tuple[float, float], expected: int) -> None:
    at = every_metre(40)
    noise = np.random.default_rng(0).uniform(-0.2, 0.2, at.shape)
    assert agreeing(at, np.array(off_m) + noise) == expected


def test_matches_at_random_hardly_agree() -> None:
    at = every_metre(72)
    assert agreeing(at, np.random.default_rng(1).uniform(-3, 3, at.shape)) < 10


def test_matches_of_one_place_count_once() -> None:
    at = np.repeat(every_metre(5), 30, axis=0)
    assert agreeing(at, np.zeros_like(at)) == 5


def test_walls_add_up_and_may_have_nothing() -> None:
    at = every_metre(7)
    assert agreeing(at, np.zeros_like(at), walls=3) == 21
    assert agreeing(np.zeros((0, 2)), np.zeros((0, 2))) == 0

    def never(a: Raster, b: Raster) -> tuple[Array, Array]:
        raise AssertionError("nothing is seen of the wall from both sides")

    assert agreeing_cells([pair(known=False)], never) == 0
