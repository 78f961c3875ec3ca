# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader, MemoryFile

from skymoor.errors import DegenerateGeometry, InputError
from skymoor.geo import EnuFrame, Grid
from skymoor.results.formats import geotiffs

Array = NDArray[np.float64]

FRAME = EnuFrame(46.5, 7.5, 600.0)
GRID = Grid(900.0, -300.0, 0.5, (300, 400))  # 1 km off the origin, where the axes of map and ENU differ most
SURE = np.full(GRID.shape, 80, np.uint8)
PERIOD_M = 40.0
CRSS = ["EPSG:32632", "EPSG:4326", "EPSG:2056", "EPSG:3857"]


def terrain() -> tuple[NDArray[np.uint8], Array]:
    """A picture that says where it is (red grows east, green north, again every 40 m) on hills of 60 m."""
    plan = GRID.centres()
    rgb = np.zeros((*GRID.shape, 3), np.uint8)
    rgb[..., :2] = np.rint(255 / PERIOD_M * np.mod(plan, PERIOD_M))
    height = 30 * np.sin(plan[..., 0] / 25) + 30 * np.cos(plan[..., 1] / 30)
    return rgb, height


def known_enu(dsm: DatasetReader) -> tuple[Array, NDArray[np.bool_]]:
    """ENU (n, 3) of the known pixels of a DSM, read as any other program would, and which pixels are known."""
    values = dsm.read(1)
    known = values != dsm.nodata
    rows, columns = np.nonzero(known)
    t = dsm.transform
    lon_lat_from_map = Transformer.from_crs(dsm.crs.to_wkt(), "EPSG:4326", always_xy=True)
    lon, lat = lon_lat_from_map.transform(t.c + t.a * (columns + 0.5), t.f + t.e * (rows + 0.5))
    return FRAME.enu_from_lla(lat, lon, values[known].astype(float)), known


@pytest.mark.parametrize("crs", CRSS)
def test_pixels_lie_within_a_tenth_of_a_pixel(crs: str) -> None:
    rgb, height = terrain()
    ortho_bytes, dsm_bytes, _ = geotiffs(rgb, height, SURE, GRID, FRAME, crs)
    with MemoryFile(ortho_bytes) as a, MemoryFile(dsm_bytes) as b, a.open() as ortho, b.open() as dsm:
        assert ortho.transform == dsm.transform
        xyz_enu, known = known_enu(dsm)
        red, green, blue, alpha = ortho.read()
    np.testing.assert_array_equal(alpha > 0, known)
    assert known.mean() > 0.8
    assert blue.max() == 0
    for axis, colour in ((0, red), (1, green)):
        place = np.mod(xyz_enu[:, axis], PERIOD_M)
        # Where the colour starts anew, neighbours mix into a place that is neither.
        clear = (place > 1.0) & (place < PERIOD_M - 1.0)
        shift = colour[known] * (PERIOD_M / 255) - place
        middle = np.median(xyz_enu[:, :2], axis=0)
        # In every quarter, so that no stretch or turn hides behind the mean.
        for east, north in itertools.product((True, False), repeat=2):
            part = clear & ((xyz_enu[:, 0] > middle[0]) == east) & ((xyz_enu[:, 1] > middle[1]) == north)
            assert abs(shift[part].mean()) < 0.1 * GRID.pixel_m
            assert np.abs(shift[part]).max() < 0.6 * GRID.pixel_m


@pytest.mark.parametrize("crs", CRSS)
def test_heights_are_ellipsoidal_and_in_place(crs: str) -> None:
    rgb, height = terrain()
    with MemoryFile(geotiffs(rgb, height, SURE, GRID, FRAME, crs)[1]) as memory, memory.open() as dsm:
        xyz_enu, _ = known_enu(dsm)
        assert (dsm.dtypes, dsm.nodata, dsm.units) == (("float32",), -9999.0, ("m",))
        assert dsm.tags()["VERTICAL_DATUM"] == "ellipsoid"
    expected = 30 * np.sin(xyz_enu[:, 0] / 25) + 30 * np.cos(xyz_enu[:, 1] / 30)
    inner = (np.abs(xyz_enu[:, 0] - 1000) < 95) & (np.abs(xyz_enu[:, 1] + 375) < 70)
    error = xyz_enu[inner, 2] - expected[inner]
    # Slopes reach 1.2: 0.1 px of 0.5 m would be 6 cm; the bilinear sag on the hills is below 1 cm.
    assert np.abs(error).max() < 0.03
    assert abs(error.mean()) < 0.005
    assert inner.sum() > 50_000 or crs == "EPSG:3857"


def test_far_and_high_is_in_place_too() -> None:
    """5 km from the origin a plateau of 500 m leans 40 cm outwards on the map; the plain at its foot does not."""
    grid = Grid(4000.0, 3000.0, 0.5, (200, 300))
    plan = grid.centres()
    height = np.where(plan[..., 0] > 4060, 500.0, 0.0) + 0.2 * (plan[..., 1] - 2950)
    sure = np.full(grid.shape, 80, np.uint8)
    _, dsm_bytes, _ = geotiffs(np.zeros((*grid.shape, 3), np.uint8), height, sure, grid, FRAME, "EPSG:32632")
    with MemoryFile(dsm_bytes) as memory, memory.open() as dsm:
        xyz_enu, _ = known_enu(dsm)
    for plain, expected in ((xyz_enu[:, 0] < 4057, 0.0), (xyz_enu[:, 0] > 4063, 500.0)):
        error = xyz_enu[plain, 2] - expected - 0.2 * (xyz_enu[plain, 1] - 2950)
        assert plain.sum() > 10_000
        assert np.abs(np.median(error)) < 0.2 * 0.1 * grid.pixel_m


def test_unknown_pixels_stay_unknown() -> None:
    rgb, height = terrain()
    height[100:200, 100:300] = np.nan
    ortho_bytes, dsm_bytes, _ = geotiffs(rgb, height, SURE, GRID, FRAME, "EPSG:32632")
    with MemoryFile(dsm_bytes) as memory, memory.open() as dsm:
        xyz_enu, known = known_enu(dsm)
    px = GRID.px_from_enu(xyz_enu[:, :2])
    in_hole = ((px > [100.6, 100.6]) & (px < [299.4, 199.4])).all(axis=1)
    assert not in_hole.any()
    assert 0.99 < known.sum() / (300 * 400 - 100 * 200) < 1.01
    with MemoryFile(ortho_bytes) as memory, memory.open() as ortho:
        assert ortho.colorinterp == (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
        assert set(np.unique(ortho.read(4))) == {0, 255}


def test_confidence_goes_with_the_pixel_it_is_of() -> None:
    rgb, height = terrain()
    height[100:200, 100:300] = np.nan
    trust = SURE.copy()
    trust[:, 350:] = 0  # interpolated
    _, dsm_bytes, trust_bytes = geotiffs(rgb, height, trust, GRID, FRAME, "EPSG:32632")
    with MemoryFile(dsm_bytes) as a, MemoryFile(trust_bytes) as b, a.open() as dsm, b.open() as confidence:
        xyz_enu, known = known_enu(dsm)
        values = confidence.read(1)
        assert confidence.transform == dsm.transform and confidence.nodata == 255
    np.testing.assert_array_equal(values != 255, known)
    column = GRID.px_from_enu(xyz_enu[:, :2])[:, 0]
    assert (values[known][column > 350.6] == 0).all() and (values[known][column < 349.4] == 80).all()


def test_pixel_size_is_as_asked() -> None:
    rgb, height = terrain()
    ortho_bytes, _, _ = geotiffs(rgb, height, SURE, GRID, FRAME, "EPSG:32632", pixel_size=2.0)
    with MemoryFile(ortho_bytes) as memory, memory.open() as ortho:
        assert ortho.res == (2.0, 2.0)
        assert ortho.bounds.left % 2.0 == ortho.bounds.top % 2.0 == 0.0
        assert 100 <= ortho.width <= 105


def test_what_cannot_be_exported() -> None:
    rgb, height = terrain()
    with pytest.raises(DegenerateGeometry, match="no heights"):
        geotiffs(rgb, np.full_like(height, np.nan), SURE, GRID, FRAME, "EPSG:32632")
    with pytest.raises(InputError, match="not known"):
        geotiffs(rgb, height, SURE, GRID, FRAME, "EPSG:999999")
    with pytest.raises(ValueError, match="grid"):
        geotiffs(rgb[1:], height, SURE, GRID, FRAME, "EPSG:32632")
