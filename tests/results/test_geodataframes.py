# SPDX-License-Identifier: Apache-2.0
"""Cameras and footprints of a run as tables of geopandas, in any CRS."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

import skymoor
from skymoor.results.formats import cameras_table
from skymoor.results.read import Result
from skymoor.results.tables import CAMERA_COLUMNS
from support.exported_run import cameras, write_run
from support.finished import finished_run


@pytest.fixture
def result(tmp_path: Path) -> Result:
    return Result.read(finished_run(tmp_path))


def test_cameras_in_a_map_projection(result: Result) -> None:
    table = result.to_crs("EPSG:32632")
    assert table.crs == CRS("EPSG:32632") and list(table.columns)[:-1] == list(CAMERA_COLUMNS)
    placed = table[table["status"] == "REGISTERED"]
    assert len(table) == 10 and len(placed) == 9 and table.geometry.iloc[-1] is None
    assert not placed.geometry.has_z.any()  # a CRS without heights has points without a height
    inverse = Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True)
    lon, lat = inverse.transform(placed.geometry.x, placed.geometry.y)
    np.testing.assert_allclose(lat, placed["lat"].astype(float), atol=1e-9)
    np.testing.assert_allclose(lon, placed["lon"].astype(float), atol=1e-9)
    # Neighbours are as far apart as in metres of the site, up to the scale of the projection.
    xy = np.column_stack([placed.geometry.x, placed.geometry.y])
    site = placed[["east", "north"]].to_numpy(float)
    scale = np.linalg.norm(xy[1:] - xy[0], axis=1) / np.linalg.norm(site[1:] - site[0], axis=1)
    assert np.all(scale > 0.9995) and np.all(scale < 1.0005) and np.all(scale != 1)


def test_heights_are_those_of_the_datum_or_none(result: Result) -> None:
    row = result.cameras[0]
    assert result.to_crs("EPSG:4979").geometry.iloc[0].z == pytest.approx(row.height, abs=1e-9)
    earth = result.to_crs("EPSG:4978").geometry.iloc[0]
    assert np.linalg.norm([earth.x, earth.y, earth.z]) == pytest.approx(6_366_800, abs=3000)
    rows = [replace(one, height=None, le90=None, heights="NOT_CONFIRMED") for one in result.cameras]
    with (result.folder / "cameras.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, CAMERA_COLUMNS)
        writer.writeheader()
        writer.writerows(cameras_table(rows))
    without = Result.read(result.folder)
    assert np.isnan(without.to_crs("EPSG:4979").geometry.iloc[0].z)
    assert without.to_crs("EPSG:32632").geometry.iloc[0].x == pytest.approx(
        result.to_crs("EPSG:32632").geometry.iloc[0].x
    )


def test_nothing_registered_is_a_table_without_points(tmp_path: Path) -> None:
    table = Result.read(finished_run(tmp_path, registered=False)).to_crs("EPSG:32632")
    assert len(table) == 10 and table.geometry.isna().all() and table.crs == CRS("EPSG:32632")


def test_footprints_are_on_the_ground_below_their_cameras(tmp_path: Path) -> None:
    result = Result.read(write_run(tmp_path))
    table = result.to_crs("EPSG:32719", "footprints")
    assert table.crs == CRS("EPSG:32719") and result.to_geodataframe("footprints").crs == CRS("EPSG:4326")
    assert len(table) == len(result.registered_cameras) == 4
    points = result.to_crs("EPSG:32719").set_index("image").geometry
    lens = cameras()[0].intrinsics
    for image, outline in zip(table["image"], table.geometry, strict=True):
        assert outline.is_valid and outline.centroid.distance(points[image]) < 20
        # 70 to 74 m above ground up to 8 m high, at 260 px of focal length.
        nadir = lens.width * lens.height / 261**2
        assert 0.9 * 62**2 * nadir < outline.area < 1.2 * 74**2 * nadir
    compound = result.to_crs("EPSG:32719+5773", "footprints")  # heights play no part, so no grid is needed
    assert compound.crs == table.crs and np.allclose(compound.area, table.area)


def test_what_cannot_be_is_one_line(result: Result) -> None:
    with pytest.raises(skymoor.InputError, match="CRS 'EPSG:99999' is not known to PROJ"):
        result.to_crs("EPSG:99999")
    with pytest.raises(skymoor.InputError, match="layer 'photos' is not known; it is one of cameras, footprints"):
        result.to_crs("EPSG:32632", "photos")  # type: ignore[arg-type]
