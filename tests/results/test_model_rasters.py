# SPDX-License-Identifier: Apache-2.0
"""Rasters of the models: their own extent and pixel, confidence beside, and only small holes filled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.pipeline.job import ComponentResult
from skymoor.results.formats.raster import INTERPOLATED, UNKNOWN
from skymoor.results.model_rasters import model_rasters, small_holes
from skymoor.types import Registration, Render, View
from support.blocks import block

SCALE = 50.0
VIEW = View(np.diag([1.0, -1.0, -1.0]), -0.5, -0.4, 0.004, (200, 250))  # pixels of 0.2 m


def shown(hole: tuple[slice, slice] | None = None, *, shift_m: float = 0.0, grey: int = 90) -> ComponentResult:
    u, v = np.meshgrid(np.arange(250) + 0.5, np.arange(200) + 0.5)
    x, y = VIEW.x0 + u * VIEW.pixel, -(VIEW.y0 + v * VIEW.pixel)
    xyz = np.stack([x, y, 0.1 * x], axis=-1).astype(np.float32)
    if hole is not None:
        xyz[hole] = np.nan
    confidence = np.full(VIEW.shape, 0.6, np.float32)
    confidence[:, :50] = 0.05
    render = Render(VIEW, np.full((*VIEW.shape, 3), grey, np.uint8), xyz, confidence)
    transform = Similarity(SCALE, np.eye(3), np.array([100.0 + shift_m, 200.0, 7.0]))
    found = Registration(True, "", transform)
    return ComponentResult("airborne-0", block("orbit", relief_m=1.0), Similarity.identity(), found, render=render)


def test_extent_and_pixel_are_the_models_own() -> None:
    found = model_rasters([shown()])
    assert found is not None
    assert found.grid.pixel_m == pytest.approx(0.2)
    assert found.grid.bounds == pytest.approx((75.0, 180.0, 125.0, 220.0), abs=0.21)
    known = np.isfinite(found.height)
    assert known.mean() > 0.98
    east = found.grid.centres()[..., 0]
    np.testing.assert_allclose(found.height[known], (7 + 0.1 * (east - 100))[known], atol=0.02)
    # What is not sure is there as well, and says so.
    assert (found.confidence[10:-10, 5:40] == 5).all() and (found.confidence[10:-10, 60:-10] == 60).all()
    assert (found.confidence[~known] == UNKNOWN).all()


def test_small_holes_are_filled_and_marked_and_large_ones_stay() -> None:
    small, large = np.s_[100:103, 120:123], np.s_[40:70, 150:190]
    found = model_rasters([shown(small)])
    assert found is not None
    filled = found.confidence == INTERPOLATED
    assert 4 <= filled.sum() <= 30
    rows, columns = np.nonzero(filled)
    assert (abs(rows - 101) < 4).all() and (abs(columns - 121) < 4).all()
    east = found.grid.centres()[..., 0]
    np.testing.assert_allclose(found.height[filled], (7 + 0.1 * (east - 100))[filled], atol=0.1)
    assert (found.rgb[filled] == 90).all()
    open_ = model_rasters([shown(large)])
    assert open_ is not None
    assert not (open_.confidence == INTERPOLATED).any() and np.isnan(open_.height[50:60, 160:180]).all()


def test_smaller_components_fill_what_larger_leave() -> None:
    found = model_rasters([shown(), shown(shift_m=30.0, grey=200)])
    assert found is not None
    assert found.grid.bounds[2] == pytest.approx(155.0, abs=0.3)
    middle = found.rgb[found.grid.shape[0] // 2, :, 0]
    assert (middle[5:240] == 90).all() and (middle[260:390] == 200).all()


def test_the_number_of_pixels_is_limited() -> None:
    found = model_rasters([shown()], max_pixels=10_000)
    assert found is not None and 8_000 < np.prod(found.grid.shape) < 11_000


def test_nothing_registered_is_nothing() -> None:
    refused = replace(shown(), registration=Registration(False, "", None))
    assert model_rasters([refused]) is None and model_rasters([]) is None


def test_holes_at_the_border_are_not_enclosed() -> None:
    known = np.ones((20, 30), bool)
    known[0:2, 5:7] = known[10:12, 10:12] = known[5:9, 20:25] = False
    holes = small_holes(known, 6)
    assert holes[10:12, 10:12].all() and holes.sum() == 4
