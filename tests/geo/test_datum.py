# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from pyproj.datadir import get_data_dir, get_user_data_dir

from skymoor.errors import InputError
from skymoor.geo import ellipsoidal_heights, vertical_datum_of
from skymoor.geo.datum import horizontal_part, same_vertical_datum, unit_of_datum, vertical_unit_of
from support.geoid import write_constant_geoid


def test_ellipsoid_changes_nothing() -> None:
    for name in ("ellipsoid", "Ellipsoid ", "EPSG:4979"):
        heights = ellipsoidal_heights([47.0, 47.1], 8.3, [400.0, np.nan], name)
        np.testing.assert_array_equal(heights, [400.0, np.nan])


@pytest.mark.parametrize(
    ("datum", "place", "file"),
    [
        ("EPSG:3855", (47.0, 8.3), "us_nga_egm08_25.tif"),
        ("EPSG:5773", (47.0, 8.3), "us_nga_egm96_15.tif"),
        ("EPSG:5703", (40.0, -100.0), "us_noaa_g2018u0.tif"),
        ("EPSG:6360", (40.0, -100.0), "us_noaa_g2018u0.tif"),
        ("EPSG:9518", (47.0, 8.3), "us_nga_egm08_25.tif"),  # compound: its vertical part counts
    ],
)
def test_missing_grid_is_named(datum: str, place: tuple[float, float], file: str) -> None:
    if any((Path(folder) / file).exists() for folder in (get_data_dir(), get_user_data_dir())):
        pytest.skip(f"{file} is installed here")
    with pytest.raises(InputError) as caught:
        ellipsoidal_heights(*place, 400.0, datum)
    message = str(caught.value)
    assert datum in message
    assert file in message
    assert "`skymoor grids fetch us_n" in message
    assert "\n" not in message


def test_datum_without_a_way_at_the_site() -> None:
    # NAVD88 is a datum of North America; in Europe nothing leads from it to the ellipsoid.
    with pytest.raises(InputError, match=r"EPSG:5703 \(NAVD88 height\)"):
        ellipsoidal_heights(47.0, 8.3, 400.0, "EPSG:5703")


@pytest.mark.parametrize("datum", ["EPSG:4326", "EPSG:32632", "EPSG:99999", "geoid", ""])
def test_what_is_no_vertical_datum(datum: str) -> None:
    with pytest.raises(InputError, match=r"reference\.vertical_datum"):
        ellipsoidal_heights(47.0, 8.3, 400.0, datum)


SCRIPT = """
import json, sys, pyproj
from skymoor.errors import InputError
from skymoor.geo.datum import datum_from_ellipsoid, ellipsoidal_heights
pyproj.datadir.append_data_dir(sys.argv[1])
inside = ellipsoidal_heights([47.0, 48.0, 48.0], 8.3, [400.0, 0.0, float("nan")], "EPSG:3855").tolist()
try:
    outside = str(ellipsoidal_heights(-30.0, 8.3, 400.0, "EPSG:3855"))
except InputError as error:
    outside = str(error)
back = datum_from_ellipsoid([47.0, 48.0], 8.3, [447.5, 47.5], "EPSG:3855").tolist()
print(json.dumps([inside, outside, back]))
"""


def test_installed_grid_shifts_heights(tmp_path: Path) -> None:
    # In another process, since PROJ keeps what it found in its folders.
    write_constant_geoid(tmp_path / "us_nga_egm08_25.tif", 47.5)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": str(Path(__file__).parents[2] / "src")},
    )
    inside, outside, back = json.loads(done.stdout)
    np.testing.assert_allclose(back, [400.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(inside, [447.5, 47.5, np.nan], atol=1e-6)
    assert "does not cover latitude -30" in outside


@pytest.mark.parametrize(
    ("crs", "datum"),
    [
        ("EPSG:32632", None),
        ("EPSG:4326", None),
        ("EPSG:4979", "ellipsoid"),
        ("EPSG:7415", "EPSG:5709"),
        ("EPSG:32632+3855", "EPSG:3855"),
        ("EPSG:4326+6360", "EPSG:6360"),
    ],
)
def test_vertical_datum_of_a_crs(crs: str, datum: str | None) -> None:
    assert vertical_datum_of(crs) == datum
    assert vertical_datum_of(CRS(crs)) == datum
    assert vertical_datum_of(rasterio.CRS.from_user_input(crs)) == datum
    assert len(horizontal_part(crs).axis_info) == 2


def test_same_vertical_datum() -> None:
    assert same_vertical_datum("EPSG:3855", "EPSG:9518")
    assert same_vertical_datum("ellipsoid", "EPSG:4979")
    assert not same_vertical_datum("ellipsoid", "EPSG:3855")
    assert not same_vertical_datum("EPSG:5703", "EPSG:6360")  # metres and feet


def test_units_of_vertical_crs() -> None:
    foot = 1200 / 3937
    for datum, unit in (("ellipsoid", 1.0), ("EPSG:5703", 1.0), ("EPSG:6360", foot), ("EPSG:8228", 0.3048)):
        assert unit_of_datum(datum) == pytest.approx(unit, rel=1e-12)
    for crs, known in (("EPSG:32632", None), ("EPSG:4979", 1.0), ("EPSG:4326+6360", foot), ("EPSG:7415", 1.0)):
        assert vertical_unit_of(crs) == (None if known is None else pytest.approx(known, rel=1e-12))
