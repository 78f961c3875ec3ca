# SPDX-License-Identifier: Apache-2.0
"""Heights that say nothing are not compared."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geo import EnuFrame, Grid
from skymoor.match.rasters import reference_raster
from skymoor.types import Reference

GRID = Grid(0.0, 0.0, 0.5, (40, 60))


def reference(height: np.ndarray) -> Reference:
    rgb, mask = np.zeros((*GRID.shape, 3), np.uint8), np.ones(GRID.shape, bool)
    return Reference(EnuFrame(47.0, 8.0, 400.0), GRID, rgb, mask, height.astype(np.float32), np.eye(3), 0.5)


def test_relief_is_in_pixels() -> None:
    height = np.linspace(0, 10, GRID.shape[0] * GRID.shape[1]).reshape(GRID.shape)
    found = reference_raster(reference(height)).height
    assert found is not None
    np.testing.assert_allclose(found, 2 * height, rtol=1e-6)


@pytest.mark.parametrize("value", [np.nan, 0.0, 123.4])
def test_flat_or_unknown_heights_are_none(value: float) -> None:
    assert reference_raster(reference(np.full(GRID.shape, value))).height is None
