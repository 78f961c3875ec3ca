# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io

import laspy
import numpy as np
import pytest
from pyproj import CRS, Transformer

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geo.datum import horizontal_part
from skymoor.results.formats import pointcloud_las

FRAME = EnuFrame(46.5, 7.5, 600.0)


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:4326", "EPSG:32632+5773", "EPSG:2056"])
def test_points_lie_where_they_should(crs: str) -> None:
    rng = np.random.default_rng(0)
    enu, colours = rng.uniform(-300, 300, (200, 3)), rng.integers(0, 256, (200, 3), np.uint8)
    cloud = laspy.read(io.BytesIO(pointcloud_las(enu, colours, FRAME, crs)))
    stored = cloud.header.parse_crs()
    assert stored.to_2d() == horizontal_part(crs)
    lon_lat_from_map = Transformer.from_crs(stored.to_2d(), CRS("EPSG:4326"), always_xy=True)
    lon, lat = lon_lat_from_map.transform(np.asarray(cloud.x), np.asarray(cloud.y))
    errors = FRAME.enu_from_lla(lat, lon, np.asarray(cloud.z)) - enu
    assert np.abs(errors).max() < 0.002
    np.testing.assert_array_equal(np.asarray(cloud.red) // 257, colours[:, 0])
    np.testing.assert_array_equal(np.asarray(cloud.blue) // 257, colours[:, 2])


def test_header_tells_the_heights_where_it_can() -> None:
    for crs, axes in (("EPSG:32632", 3), ("EPSG:25832", 3), ("EPSG:2056", 2)):  # the last has Bessel's ellipsoid
        cloud = laspy.read(io.BytesIO(pointcloud_las(np.zeros((1, 3)), np.zeros((1, 3), np.uint8), FRAME, crs)))
        stored = cloud.header.parse_crs()
        assert len(stored.axis_info) == axes
        assert axes == 2 or "ellipsoidal height" in stored.axis_info[2].name.lower()
        assert float(cloud.z[0]) == pytest.approx(600.0, abs=0.001)


def test_utm_is_not_enu() -> None:
    """The point 1 km east is not 1 km east on the map: the scale and the convergence of UTM must be in it."""
    enu = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0]])
    cloud = laspy.read(io.BytesIO(pointcloud_las(enu, np.zeros((2, 3), np.uint8), FRAME, "EPSG:32632")))
    dx, dy = float(cloud.x[1] - cloud.x[0]), float(cloud.y[1] - cloud.y[0])
    assert -0.6 < np.hypot(dx, dy) - 1000.0 < -0.1
    # 1.5 degrees west of the central meridian the convergence is 1.5 * sin(46.5) = 1.09 degrees: the map turns by it.
    assert -20.0 < dy < -18.0


def test_unknown_points_are_left_out_and_none_is_fine() -> None:
    enu = np.array([[np.nan, 0, 0], [1.0, 2.0, 3.0]])
    assert len(laspy.read(io.BytesIO(pointcloud_las(enu, np.zeros((2, 3), np.uint8), FRAME, "EPSG:32632")))) == 1
    empty = pointcloud_las(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), FRAME, "EPSG:32632")
    assert len(laspy.read(io.BytesIO(empty))) == 0


@pytest.mark.parametrize("crs", ["nonsense", "EPSG:5773", "EPSG:4978"])
def test_unusable_crs(crs: str) -> None:
    with pytest.raises(InputError, match="coordinate reference system"):
        pointcloud_las(np.zeros((1, 3)), np.zeros((1, 3), np.uint8), FRAME, crs)
