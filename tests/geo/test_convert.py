# SPDX-License-Identifier: Apache-2.0
"""Positions in another CRS, against PROJ's own inverse, and against what its definition says."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geo.convert import map_crs, positions_in
from skymoor.geo.operations import installed_grids
from support.geoid import write_constant_geoid

LAT, LON, HEIGHT = np.array([48.0, 48.002, 47.999]), np.array([11.0, 11.003, 10.998]), np.array([540.0, 551.5, 530.25])


def test_utm_is_that_of_its_definition() -> None:
    # On the central meridian easting is 500 km, and northing 0.9996 of the arc from the equator, here to 45 degrees.
    (x, y), *_ = positions_in(map_crs("EPSG:32632"), [45.0], [9.0], [100.0])
    assert x == pytest.approx(500_000, abs=1e-6) and y == pytest.approx(0.9996 * 4_984_944.378, abs=2e-3)


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:4979", "EPSG:4978", "EPSG:3857", "EPSG:31468", "EPSG:25832"])
def test_there_and_back(crs: str) -> None:
    target = map_crs(crs)
    found = positions_in(target, LAT, LON, HEIGHT)
    assert found.shape == (3, len(target.axis_info))
    whole = "EPSG:4979" if found.shape[1] == 3 else "EPSG:4326"
    lon, lat, *up = Transformer.from_crs(target, whole, always_xy=True).transform(*found.T)
    error = EnuFrame(48.0, 11.0, 540.0).enu_from_lla(lat, lon, up[0] if up else HEIGHT)
    error -= EnuFrame(48.0, 11.0, 540.0).enu_from_lla(LAT, LON, HEIGHT)
    limit_m = 3.0 if crs == "EPSG:31468" else 2e-3  # which of the operations to an old datum is taken depends on PROJ
    assert np.abs(error).max() < limit_m
    # They are not just passed through, and neighbours are as far apart as they are on Earth.
    assert np.abs(found[:, 0] - LON).min() > 1.0 or target.is_geographic


def test_lengths_are_those_of_the_earth() -> None:
    frame = EnuFrame(48.0, 11.0, 0.0)
    lat, lon, height = frame.lla_from_enu([[0, 0, 0], [300, 0, 0], [0, 400, 0]]).T
    xy = positions_in(map_crs("EPSG:32632"), lat, lon, height)
    lengths = np.linalg.norm(xy[1:] - xy[0], axis=1) / [300, 400]
    assert np.all(lengths > 0.9996) and np.all(lengths < 1.0001)
    assert xy[1, 0] - xy[0, 0] > 299 and xy[2, 1] - xy[0, 1] > 399  # x is east


def test_east_comes_first_whatever_the_crs_says() -> None:
    assert CRS("EPSG:31468").axis_info[0].direction == "north"
    (x, y), *_ = positions_in(map_crs("EPSG:31468"), [48.0], [11.0], [0.0])
    assert 4_400_000 < x < 4_440_000 and 5_300_000 < y < 5_340_000


def test_heights_that_are_not_known_stay_so() -> None:
    found = positions_in(map_crs("EPSG:4979"), LAT, LON, [540.0, np.nan, 530.25])
    np.testing.assert_allclose(found[:, 2], [540.0, np.nan, 530.25], atol=1e-6)
    with pytest.raises(InputError, match="geocentric, and a height is not confirmed"):
        positions_in(map_crs("EPSG:4978"), LAT, LON, [540.0, np.nan, 530.25])
    assert positions_in(map_crs("EPSG:4979"), [], [], []).shape == (0, 3)


SCRIPT = """
import json, sys, numpy, pyproj
from skymoor.geo.convert import map_crs, positions_in
pyproj.datadir.append_data_dir(sys.argv[1])
lat, lon, height = numpy.array(json.loads(sys.argv[2]))
found = positions_in(map_crs("EPSG:32632+3855"), lat, lon, height)
back = pyproj.Transformer.from_crs("EPSG:32632+3855", "EPSG:4979", always_xy=True).transform(*found.T)
print(json.dumps([found.tolist(), numpy.array(back).tolist()]))
"""


def test_a_compound_crs_has_the_heights_of_its_datum(tmp_path: Path) -> None:
    # In another process, since PROJ keeps what it found in its folders.
    write_constant_geoid(tmp_path / "us_nga_egm08_25.tif", 47.5)
    given = json.dumps([LAT.tolist(), LON.tolist(), HEIGHT.tolist()])
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path), given],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": str(Path(__file__).parents[2] / "src")},
    )
    found, back = (np.array(one) for one in json.loads(done.stdout))
    np.testing.assert_allclose(found[:, 2], HEIGHT - 47.5, atol=1e-4)  # not those above the ellipsoid
    np.testing.assert_allclose(found[:, :2], positions_in(map_crs("EPSG:32632"), LAT, LON, HEIGHT), atol=1e-4)
    np.testing.assert_allclose(back[2], HEIGHT, atol=1e-4)
    np.testing.assert_allclose(back[:2], [LON, LAT], atol=1e-9)


@pytest.mark.parametrize(
    ("crs", "file"),
    [
        ("EPSG:32632+3855", "us_nga_egm08_25.tif"),
        ("EPSG:25832+5773", "us_nga_egm96_15.tif"),
        ("EPSG:25832+7837", "de_bkg_gcg2016.tif"),
    ],
)
def test_a_missing_grid_is_named(crs: str, file: str) -> None:
    if file in installed_grids():
        pytest.skip(f"{file} is installed here")
    with pytest.raises(InputError, match=rf"needs the grid {file}.*`skymoor grids fetch {file}`") as caught:
        positions_in(map_crs(crs), LAT, LON, HEIGHT)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("crs", ["EPSG:99999", "UTM 32", "", "EPSG:3855", 7, None])
def test_what_is_no_crs_of_positions(crs: object) -> None:
    with pytest.raises(InputError, match=r'CRS .*"EPSG:32632"') as caught:
        map_crs(crs)
    assert "\n" not in str(caught.value)


def test_a_crs_of_another_region_is_refused() -> None:
    with pytest.raises(
        InputError, match="no transformation to it from WGS 84 at the site; choose a CRS of that region"
    ):
        positions_in(map_crs("EPSG:26910"), LAT, LON, HEIGHT)
