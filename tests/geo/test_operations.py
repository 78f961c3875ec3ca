# SPDX-License-Identifier: Apache-2.0
"""The accuracy that PROJ states, as standard deviations, and the grids that would improve it."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import CRS, Geod, Transformer

from skymoor.geo import ce90_m
from skymoor.geo.operations import Operation, accuracy_note, grid_file, horizontal_operation, installed_grids

OSTN15 = "uk_os_OSTN15_NTv2_OSGBtoETRS.tif"


@pytest.mark.parametrize(
    ("crs", "lon", "lat"),
    [
        ("EPSG:32632", 8.0, 47.0),
        ("EPSG:3857", 8.0, 47.0),
        ("EPSG:4326", 8.0, 47.0),
        ("EPSG:9755", 8.0, 47.0),  # a realisation of WGS 84
        ("EPSG:9000", 8.0, 47.0),  # ITRF2014
    ],
)
def test_wgs_84_is_exact(crs: str, lon: float, lat: float) -> None:
    found = horizontal_operation(CRS(crs), lon, lat)
    assert found.sigma_m < 0.01 and found.missing == ()
    assert accuracy_note(found, "ortho.tif") == ""


@pytest.mark.parametrize(
    ("crs", "lon", "lat", "stated_m", "sigma_m"),
    [
        ("EPSG:2056", 8.0, 47.0, 1.0, 1.0),
        ("EPSG:4301", 139.0, 35.0, 9.0, 9.0),  # Tokyo
        # Coordinates pass unchanged: the bound of 95 percent of a circle is 2.45 standard deviations.
        ("EPSG:25832", 8.0, 47.0, 1.0, 1.0 / 2.4477),  # ETRS89
        ("EPSG:6344", -93.0, 40.0, 2.0, 2.0 / 2.4477),  # NAD83(2011)
    ],
)
def test_what_proj_states(crs: str, lon: float, lat: float, stated_m: float, sigma_m: float) -> None:
    found = horizontal_operation(CRS(crs), lon, lat)
    assert found.stated_m == stated_m and found.sigma_m == pytest.approx(sigma_m, rel=1e-4)
    note = accuracy_note(found, "ortho.tif")
    assert "ortho.tif" in note and f"{stated_m:g} m" in note and "\n" not in note


def test_british_grid_without_its_grid_is_told_and_covered() -> None:
    """A point whose true position is known comes 3.17 m off, which CE90 has to hold."""
    if grid_file(OSTN15):
        pytest.skip(f"{OSTN15} is installed here")
    lon, lat = Transformer.from_crs("EPSG:27700", "EPSG:4326", always_xy=True).transform(624161.0, 308459.58)
    off_m = Geod(ellps="WGS84").inv(lon, lat, 1.31073349, 52.62760352)[2]
    assert 3.0 < off_m < 3.3
    found = horizontal_operation(CRS("EPSG:27700"), 1.31, 52.63)
    added_m = ce90_m(np.eye(2) * found.sigma_m**2)
    assert off_m < added_m < 2 * off_m
    assert (found.stated_m, found.better_m, found.missing) == (2.0, 1.0, (OSTN15,))
    assert f"`skymoor grids fetch {OSTN15}`" in accuracy_note(found, "ortho.tif")


def test_accuracy_that_is_not_stated() -> None:
    found = horizontal_operation(CRS("+proj=utm +zone=32 +ellps=GRS80 +towgs84=0,0,0"), 8.0, 47.0)
    assert np.isnan(found.stated_m) and found.sigma_m == 0
    assert "states no accuracy" in accuracy_note(found, "ortho.tif")
    assert accuracy_note(Operation("x", 0.05, 0.05), "ortho.tif") == ""


def test_installed_grids_are_names() -> None:
    assert all("/" not in name for name in installed_grids())
    assert grid_file("no_such_grid.tif") is None
