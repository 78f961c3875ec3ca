# SPDX-License-Identifier: Apache-2.0
"""Undeclared nodata is found among possible heights; what is level for another reason is not taken for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from skymoor.errors import InputError
from skymoor.reference.nodata import Sampled, undeclared_nodata
from support.map_scene import read, rewrite, write_dsm, write_ortho

Array = NDArray[np.float64]
SIDE = 240
HOLE = np.s_[100:140, 50:120]
SHARE = 40 * 70 / SIDE**2


def hills(base: float = 450.0, relief: float = 20.0) -> Array:
    """Smooth hills of that standard deviation, with 5 cm of noise."""
    rng = np.random.default_rng(3)
    smooth = gaussian_filter(rng.normal(size=(SIDE, SIDE)), 15)
    return smooth / smooth.std() * relief + base + rng.normal(0, 0.05, (SIDE, SIDE))


def city(base: float) -> Array:
    """A rough plain with flat roofs 3 to 40 m above it."""
    rng = np.random.default_rng(4)
    heights = hills(base, 1.0)
    for _ in range(60):
        row, column, rows, columns = (*rng.integers(0, SIDE - 30, 2), *rng.integers(8, 30, 2))
        heights[row : row + rows, column : column + columns] = base + rng.uniform(3, 40)
    return heights


def boxes(roof: Callable[[int], Array | float]) -> Array:
    """Objects on the level ground of a simple scene."""
    rng, heights = np.random.default_rng(5), np.zeros((SIDE, SIDE))
    for k in range(15):
        row, column = rng.integers(0, SIDE - 16, 2)
        heights[row : row + 15, column : column + 15] = roof(k)
    return heights


def with_hole(heights: Array, value: float) -> Array:
    heights[HOLE] = value
    return heights


def with_collar(heights: Array, value: float) -> Array:
    """As a rotated raster is stored."""
    u, v = np.meshgrid(*2 * [np.arange(SIDE) - SIDE / 2])
    heights[np.abs(u) + np.abs(v) > 0.55 * SIDE] = value
    return heights


def mixed_at_the_rim(heights: Array) -> Array:
    """Resampled by a program that took the nodata value for a height."""
    with_hole(heights, 0.0)
    hole = heights == 0
    share = gaussian_filter(hole.astype(float), 0.6)
    return np.where(~hole & (share > 0.01), heights * (1 - share), heights)


@pytest.mark.parametrize("value", [0.0, -1.0, -99.0])
def test_a_usual_value_is_found(value: float) -> None:
    for heights, share in ((with_hole(hills(), value), SHARE), (with_hole(city(100.0), value), SHARE)):
        found = undeclared_nodata(Sampled(heights, 1.0))
        assert found is not None and found == pytest.approx((value, share))
    found = undeclared_nodata(Sampled(with_collar(hills(), value), 1.0))
    assert found is not None and found[0] == value and 0.3 < found[1] < 0.5


@pytest.mark.parametrize("value", [9999.0, -999.0, 32767.0])
def test_values_that_another_unit_makes_possible(value: float) -> None:
    """Heights in feet, or centimetres."""
    unit = 0.01 if value > 10_000 else 0.3048
    found = undeclared_nodata(Sampled(with_hole(hills(), value * unit), 1.0, scale=unit))
    assert found is not None and found == pytest.approx((value, SHARE))


def test_number_of_the_file_is_named() -> None:
    found = undeclared_nodata(Sampled(with_hole(hills(), 300.0), 1.0, scale=0.01, offset=300.0))
    assert found is not None and found == pytest.approx((0.0, SHARE))


@pytest.mark.parametrize(
    "heights",
    [
        with_hole(np.round(hills(450.0, 60.0)), 0.0),  # of whole metres
        with_hole(hills(1450.0, 300.0), 0.0),
        mixed_at_the_rim(hills()),
        with_hole(hills(), 1.0),  # no usual value, but far below all else
    ],
    ids=["integers", "mountains", "mixed at the rim", "least value"],
)
def test_found_among_other_heights(heights: Array) -> None:
    found = undeclared_nodata(Sampled(heights, 1.0))
    assert found is not None and found[0] == heights[HOLE][5, 5]


def fjord() -> Array:
    wall = np.maximum(1.3 * (np.abs(np.arange(SIDE) - SIDE / 2) - 30), 0.0) * np.ones((SIDE, 1))
    return np.where(wall > 0, wall + np.random.default_rng(6).normal(0, 0.3, wall.shape), 0.0)


def harbour() -> Array:
    heights = city(3.0)
    heights[:, :90] = 0.0
    return heights


def tower() -> Array:
    heights = city(100.0)
    heights[50:80, 50:80] = 300.0
    return heights


LEVEL = {
    "sea": np.maximum(hills(0.0, 20.0), 0.0),
    "lake": np.maximum(hills(60.0, 40.0), 30.0),
    "polder": np.maximum(hills(3.0, 3.0), -1.0),
    "fjord": fjord(),
    "harbour with quays": harbour(),
    "flat roof of a tower": tower(),
    "whole metres": np.round(hills(450.0, 60.0)),
    "whole metres about zero": np.round(hills(0.0, 3.0)),
    "one value": np.full((SIDE, SIDE), -1.0),
    "boxes": boxes(lambda k: 12.0 + k),
    "boxes of one height": boxes(lambda k: 20.0),
    "gables": boxes(lambda k: 12.0 + np.abs(np.arange(15) - 7.0)),
    "a few pixels": np.where(np.arange(SIDE**2).reshape(SIDE, SIDE) < 9, 0.0, hills()),
}


@pytest.mark.parametrize("name", LEVEL)
def test_level_for_another_reason(name: str) -> None:
    assert undeclared_nodata(Sampled(LEVEL[name], 1.0)) is None


def test_a_slope_that_one_step_of_a_coarse_raster_takes_is_no_cliff() -> None:
    heights = with_hole(hills(20.0, 2.0), 0.0)
    assert undeclared_nodata(Sampled(heights, 1.0)) is not None
    assert undeclared_nodata(Sampled(heights, 30.0)) is None


def spoilt(folder: Path, **profile: object) -> tuple[Path, Path]:
    def hole(bands: NDArray[np.float32]) -> NDArray[np.float32]:
        bands[:, 40:60, 50:80] = 0.0
        return bands

    return write_ortho(folder), rewrite(write_dsm(folder), hole, **profile)


def test_one_line_names_the_value_and_the_remedy(tmp_path: Path) -> None:
    ortho, dsm = spoilt(tmp_path)
    with pytest.raises(InputError) as caught:
        read(ortho, dsm)
    message = str(caught.value)
    assert "dsm.tif: 5.0% of its heights are 0" in message and "gdal_edit -a_nodata 0" in message
    assert "\n" not in message


def test_the_remedies_work(tmp_path: Path) -> None:
    ortho, dsm = spoilt(tmp_path, nodata=0.0)
    hole = ~np.isfinite(read(ortho, dsm).height[8:-8, 8:-8])
    # Half a pixel more on each side, as of every hole.
    assert hole.sum() * 0.25 == pytest.approx(21 * 31, rel=0.04)
    with rasterio.open(dsm, "r+") as raster:
        raster.nodata = -9999.0  # the plateau is real
    reference = read(ortho, dsm)
    assert (reference.height < -400).sum() * 0.25 == pytest.approx(20 * 30, rel=0.1)


@pytest.mark.parametrize(("height", "possible"), [(-560.0, False), (-440.0, True), (8900.0, True), (9999.0, False)])
def test_heights_on_earth(height: float, possible: bool, tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), rewrite(write_dsm(tmp_path), lambda bands: bands * 0 + height)
    if possible:
        assert read(ortho, dsm).frame.height_m == pytest.approx(height)
    else:
        with pytest.raises(InputError, match=r"impossible, such as .*gdal_edit -a_nodata"):
            read(ortho, dsm)
