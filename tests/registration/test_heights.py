# SPDX-License-Identifier: Apache-2.0
"""Offset, slope and scale between two surfaces are recovered at the resolution of the coarser one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom

from skymoor.geo import Grid
from skymoor.registration import HeightFit, compare_heights, ground_level, is_bare_earth, raised
from skymoor.registration.detail import blur_range

Array32 = NDArray[np.float32]
PIXEL_M = 0.5
GRID = Grid(-120.0, 100.0, PIXEL_M, (400, 480))


def terrain(seed: int = 0, relief_m: float = 3.0, reach_m: float = 12.0) -> Array32:
    field = gaussian_filter(np.random.default_rng(seed).normal(size=GRID.shape), reach_m / PIXEL_M)
    return (relief_m * field / field.std()).astype(np.float32)


def town(seed: int = 0) -> tuple[Array32, Array32]:
    """Ground of two metres of relief, and the same with houses of 4 to 10 m on a sixth of it."""
    rng = np.random.default_rng([1, seed])
    ground = terrain(seed, 2.0, 40.0)
    surface = ground.copy()
    for row in range(20, 360, 55):
        for column in range(20, 440, 60):
            h, w = rng.integers(16, 26, 2)
            surface[row : row + h, column : column + w] += np.float32(rng.uniform(4, 10))
    return ground, surface


def noisy(surface: Array32, sigma_m: float, seed: int) -> Array32:
    """With independent and with correlated errors."""
    rng = np.random.default_rng([2, seed])
    wide = gaussian_filter(rng.normal(size=surface.shape), 3.0)
    errors = rng.normal(size=surface.shape) + wide / wide.std()
    return np.asarray(surface + sigma_m / np.sqrt(2) * errors, np.float32)


def means(surface: Array32, cell_m: float) -> Array32:
    """Of cells, interpolated linearly to the grid."""
    k = round(cell_m / PIXEL_M)
    rows, columns = (side // k for side in surface.shape)
    cells = surface[: rows * k, : columns * k].reshape(rows, k, columns, k).mean(axis=(1, 3))
    coarse = np.full(surface.shape, np.nan, np.float32)
    coarse[: rows * k, : columns * k] = zoom(cells, k, order=1, grid_mode=True, mode="nearest")
    return coarse


def compared(model: Array32, reference: Array32, dsm_pixel_m: float = PIXEL_M) -> HeightFit:
    found = compare_heights(model, reference, GRID, dsm_pixel_m)
    assert found is not None
    return found


@pytest.mark.parametrize("ratio", [1.0, 0.85, 1.2, 1 / 0.3048, 0.3048, -1.0])
def test_scale_offset_and_slope_are_recovered(ratio: float) -> None:
    _, surface = town()
    plan = GRID.centres()
    tilt = (0.02 * plan[..., 0] - 0.01 * plan[..., 1]).astype(np.float32)
    found = compared(noisy(surface, 0.1, 0), noisy(np.float32(ratio) * surface + tilt + np.float32(7.5), 0.2, 1))
    assert abs(found.scale - ratio) < 3 * found.scale_sigma < 0.15 * abs(ratio)
    assert found.slope == pytest.approx([0.02, -0.01], abs=0.003)
    east, north, up = found.centre
    expected = 7.5 + (ratio - 1) * up + 0.02 * east - 0.01 * north
    assert found.offset_m == pytest.approx(expected, abs=0.3 * max(abs(ratio), 1))


def test_a_smooth_reference_is_not_a_flat_one() -> None:
    """Means over cells have less relief than the model: that is resolution, not scale."""
    for cell_m, tolerance in ((5.0, 0.1), (10.0, 0.15)):
        for seed in range(3):
            surface = terrain(seed, 3.0, 6.0)
            found = compared(noisy(surface, 0.1, seed), noisy(means(surface, cell_m), 0.1, 9 + seed))
            assert found.scale == pytest.approx(1.0, abs=tolerance)
            assert 0.8 * cell_m < found.resolution_m < 2.2 * cell_m
            assert abs(found.scale - 1) < 2.5 * found.scale_sigma


def test_the_blur_of_a_file_is_seen_in_its_detail() -> None:
    _, surface = town()
    sharp, smooth = noisy(surface, 0.1, 3), means(surface, 30.0)
    assert blur_range(sharp, PIXEL_M, PIXEL_M)[0] == 0
    low, high = blur_range(smooth, PIXEL_M, PIXEL_M)
    assert 4 < low < 15 < high
    assert blur_range(sharp, PIXEL_M, 10.0)[0] == 5.0


def test_sigmas_are_those_of_many_trials() -> None:
    squared = []
    for seed in range(12):
        surface = terrain(seed, 1.5, 10.0)
        found = compared(noisy(surface, 0.15, seed), noisy(surface, 0.3, 50 + seed))
        squared.append([((found.scale - 1) / found.scale_sigma) ** 2, found.offset_m**2 / found.covariance[2, 2]])
    # The scale's sigma holds a part that these surfaces do not have: growth, and another blur.
    assert 0.02 < np.mean(squared, axis=0)[0] < 1.5
    assert 0.1 < np.mean(squared, axis=0)[1] < 2.5


def test_changes_do_not_move_the_rest() -> None:
    """A tenth of the houses is gone in the reference, and a wood has grown in the model."""
    _, surface = town(4)
    old = surface.copy()
    old[20:60, 20:120] = terrain(4, 2.0, 40.0)[20:60, 20:120]
    new = surface.copy()
    new[300:380, 300:420] += np.float32(6.0)
    found = compared(noisy(new, 0.1, 4), noisy(old, 0.2, 5))
    assert found.scale == pytest.approx(1.0, abs=0.06)
    assert found.offset_m == pytest.approx(0.0, abs=0.1)


def test_without_enough_in_common_there_is_an_offset_and_no_more() -> None:
    surface = terrain(5)
    few = np.full_like(surface, np.nan)
    few[100:140, 100:140] = surface[100:140, 100:140]
    found = compared(few, surface + np.float32(2.0))
    assert np.isnan(found.scale) and found.offset_m == pytest.approx(2.0, abs=0.1)
    nothing = np.full_like(surface, np.nan)
    assert compare_heights(nothing, surface, GRID, PIXEL_M) is None
    assert compare_heights(surface, nothing, GRID, PIXEL_M) is None


def test_a_flat_reference_has_no_scale() -> None:
    found = compared(noisy(terrain(6), 0.1, 6), np.full(GRID.shape, 12.0, np.float32))
    assert found.reference_relief_m < 0.01 and found.scale == pytest.approx(0.0, abs=1e-3)
    assert found.offset_m + found.centre[2] == pytest.approx(12.0, abs=0.01)


class TestBareEarth:
    def test_ground_is_found_under_houses(self) -> None:
        ground, surface = town(7)
        found = ground_level(surface, PIXEL_M)
        inner = np.s_[60:340, 60:420]
        assert np.percentile(np.abs(found - ground)[inner], 90) < 0.8
        share = raised(surface, PIXEL_M).mean()
        assert (surface - ground > 2.5).mean() == pytest.approx(share, abs=0.03)

    def test_a_terrain_model_is_told_from_a_surface_model(self) -> None:
        ground, surface = town(8)
        model = noisy(surface, 0.1, 8)
        assert is_bare_earth(model, noisy(ground, 0.1, 9), PIXEL_M)
        assert not is_bare_earth(model, noisy(surface, 0.3, 9), PIXEL_M)
        assert not is_bare_earth(model, np.float32(3.28) * surface, PIXEL_M)

    def test_open_ground_tells_nothing(self) -> None:
        ground = terrain(9, 2.0, 40.0)
        assert not is_bare_earth(noisy(ground, 0.1, 1), noisy(ground, 0.1, 2), PIXEL_M)
