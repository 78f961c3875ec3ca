# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from skymoor.geo import Grid, sample

GRID = Grid(east0=-100.0, north0=60.0, pixel_m=0.5, shape=(240, 400))


def test_corners_and_centres() -> None:
    np.testing.assert_allclose(
        GRID.px_from_enu([[-100, 60], [-99.75, 59.75], [100, -60]]), [[0, 0], [0.5, 0.5], [400, 240]]
    )
    centres = GRID.centres()
    assert centres.shape == (240, 400, 2)
    np.testing.assert_allclose(centres[0, 0], [-99.75, 59.75])
    np.testing.assert_allclose(centres[-1, -1], [99.75, -59.75])
    assert GRID.bounds == (-100.0, -60.0, 100.0, 60.0)


def test_round_trip() -> None:
    px = np.random.default_rng(0).uniform(-50, 500, (100, 2))
    np.testing.assert_allclose(GRID.px_from_enu(GRID.enu_from_px(px)), px, atol=1e-10)


@pytest.mark.parametrize("values", [(0.0, 0.0, 0.0, (4, 4)), (np.nan, 0.0, 1.0, (4, 4)), (0.0, 0.0, 1.0, (0, 4))])
def test_refuses_what_is_no_grid(values: tuple[float, float, float, tuple[int, int]]) -> None:
    with pytest.raises(ValueError, match="not a grid"):
        Grid(*values)


def test_sample_is_exact_on_a_bilinear_surface() -> None:
    u, v = np.meshgrid(np.arange(7) + 0.5, np.arange(5) + 0.5)
    px = np.random.default_rng(1).uniform(0.5, 4.5, (200, 2))
    surface = 3.0 + 2.0 * u - v + 0.25 * u * v
    expected = 3.0 + 2.0 * px[:, 0] - px[:, 1] + 0.25 * px[:, 0] * px[:, 1]
    np.testing.assert_allclose(sample(surface, px), expected)


def test_sample_is_nan_next_to_a_hole_and_outside() -> None:
    raster = np.ones((4, 5), dtype=np.float32)
    raster[1, 2] = np.nan  # its centre is (2.5, 1.5)
    px = [[2.5, 1.5], [2.4, 1.5], [1.6, 0.6], [1.5, 1.5], [1.4, 1.5], [3.5, 1.0], [0.4, 1.0], [4.5, 3.5], [4.6, 3.5]]
    known = [False, False, False, True, True, True, False, True, False]
    np.testing.assert_array_equal(np.isfinite(sample(raster, px)), known)
    assert np.isnan(sample(raster, [[np.nan, 1.0], [np.inf, 1.0]])).all()
    assert sample(raster, np.zeros((0, 2))).shape == (0,)


def test_sample_of_one_pixel() -> None:
    np.testing.assert_array_equal(sample(np.array([[7.0]]), [[0.5, 0.5], [0.6, 0.5]]), [7.0, np.nan])
