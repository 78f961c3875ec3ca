# SPDX-License-Identifier: Apache-2.0
"""Heights seen from above: those of the uppermost surface, and those of the ground below it."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.walls import HeightRaster, Surface, ViewRays, check_visibility, height_raster_of

UP = np.array([0.0, 0.0, 1.0], np.float32)
CANOPY_M = 9.0


def wooded(slope: float = 0.0, *, hole: bool = False) -> HeightRaster:
    """Ground of 60 m x 60 m that rises to the east, with a canopy over 12 m x 12 m of it and a hole beside that."""
    at = np.arange(-29.75, 30.0, 0.5)
    plan = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    under = (np.abs(plan) < 6.0).all(axis=1)
    up = slope * plan[:, 0] + np.where(under, CANOPY_M, 0.0)
    kept = ~((np.abs(plan - [12.0, 0.0]) < 2.0).all(axis=1) & hole)
    xyz = np.column_stack([plan, up])[kept].astype(np.float32)
    return height_raster_of(Surface(xyz, np.tile(UP, (len(xyz), 1))))


@pytest.mark.parametrize("slope", [0.0, 0.04])
def test_the_ground_is_under_the_canopy(slope: float) -> None:
    heights = wooded(slope)
    under = np.array([[0.5, 0.5], [-4.5, 3.5], [4.5, -4.5]])
    np.testing.assert_allclose(heights.at(under), CANOPY_M + slope * under[:, 0], atol=0.05)
    # On a slope an opening by a window takes the lower side.
    np.testing.assert_allclose(heights.ground_at(under), slope * under[:, 0], atol=0.05 + 14 * slope)
    assert (heights.ground_at(under) < heights.at(under) - 0.8 * CANOPY_M).all()


def test_open_ground_is_the_uppermost_surface() -> None:
    heights = wooded()
    beside = np.array([[[20.5, 0.5], [-20.5, 10.5]], [[0.5, 15.5], [9.5, 9.5]]])
    assert heights.ground_at(beside).shape == (2, 2)
    np.testing.assert_allclose(heights.ground_at(beside), heights.at(beside), atol=1e-6)


def test_outside_there_is_neither() -> None:
    heights = wooded()
    outside = np.array([[31.0, 0.0], [0.0, -30.5], [-200.0, 200.0]])
    assert np.isnan(heights.ground_at(outside)).all()
    assert np.isnan(heights.at(outside)).all()
    assert np.isfinite(heights.ground_at(np.array([[29.9, -29.9]]))).all()


def test_unseen_ground_has_the_height_of_the_nearest_cell() -> None:
    heights, hole = wooded(hole=True), np.array([[12.5, 0.5]])
    assert heights.ground_at(hole) == pytest.approx([0.0], abs=0.05)
    assert heights.at(hole) == pytest.approx([0.0], abs=0.05)
    assert np.isnan(heights.at(hole, only_seen=True)).all()


def test_cameras_under_a_canopy_are_above_the_ground() -> None:
    centres = np.array([[0.5, 0.5, 1.7], [3.5, -2.5, 1.7], [-3.5, 2.5, 1.7]])
    rays = ViewRays(centres, centres[:, None] + [0.0, 1.0, 0.0])
    found = check_visibility(rays, Similarity.identity(), wooded(), [])
    assert found.height_m == pytest.approx(1.7, abs=0.05)
    assert (found.blocked, found.outside) == (0.0, 0.0)


def test_a_surface_without_anything_level_is_an_error() -> None:
    sideways = Surface(np.zeros((5, 3), np.float32), np.tile(np.array([1, 0, 0], np.float32), (5, 1)))
    with pytest.raises(DegenerateGeometry, match="from above"):
        height_raster_of(sideways)
