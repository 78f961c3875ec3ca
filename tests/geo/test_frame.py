# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod, Proj, Transformer

from skymoor.errors import InputError
from skymoor.geo import EnuFrame

SITE = EnuFrame(47.05, 8.3, 450.0)


@given(
    st.floats(-89.9, 89.9),
    st.floats(-179.9, 179.9),
    st.floats(-400, 8000),
    st.tuples(*[st.floats(-20_000, 20_000)] * 2, st.floats(-500, 500)),
)
@settings(max_examples=40, deadline=None)
def test_round_trip(lat: float, lon: float, height: float, xyz: tuple[float, float, float]) -> None:
    frame = EnuFrame(lat, lon, height)
    lla = frame.lla_from_enu([xyz])
    np.testing.assert_allclose(frame.enu_from_lla(*lla.T), [xyz], atol=1e-6)


def test_origin_and_axes() -> None:
    np.testing.assert_allclose(SITE.enu_from_lla(47.05, 8.3, 450.0), [[0, 0, 0]], atol=1e-6)
    east, north, up = SITE.lla_from_enu(np.eye(3) * 10.0)
    assert east[1] > 8.3
    assert abs(east[0] - 47.05) < 1e-9
    assert north[0] > 47.05
    assert abs(north[1] - 8.3) < 1e-9
    np.testing.assert_allclose(up, [47.05, 8.3, 460.0], atol=1e-9)


def test_agrees_with_the_definition_by_earth_centred_axes() -> None:
    rng = np.random.default_rng(0)
    lat, lon = 47.05 + rng.uniform(-0.05, 0.05, 50), 8.3 + rng.uniform(-0.05, 0.05, 50)
    height = rng.uniform(300, 1500, 50)
    ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    from_origin = np.column_stack(ecef.transform(lon, lat, height)) - ecef.transform(8.3, 47.05, 450.0)
    la, lo = np.radians([47.05, 8.3])
    east = [-np.sin(lo), np.cos(lo), 0]
    up = [np.cos(la) * np.cos(lo), np.cos(la) * np.sin(lo), np.sin(la)]
    axes = np.array([east, np.cross(up, east), up])
    np.testing.assert_allclose(SITE.enu_from_lla(lat, lon, height), from_origin @ axes.T, atol=1e-6)


def test_grid_convergence_and_scale_of_utm() -> None:
    # The local frame is true to scale and to north; UTM is neither, by amounts that pyproj states.
    to_utm = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True)
    factors = Proj("EPSG:32632").get_factors(8.3, 47.05)
    lla = EnuFrame(47.05, 8.3, 0.0).lla_from_enu([[0, 50.0, 0], [0, -50.0, 0]])
    (x1, y1), (x0, y0) = (to_utm.transform(lon, lat) for lat, lon, _ in lla)
    assert np.hypot(x1 - x0, y1 - y0) / 100.0 == pytest.approx(factors.meridional_scale, abs=1e-8)
    convergence_deg = np.degrees(np.arctan2(x0 - x1, y1 - y0))
    assert abs(convergence_deg) > 0.4
    assert abs(convergence_deg) == pytest.approx(abs(factors.meridian_convergence), abs=1e-5)


def test_distances_agree_with_the_geodesic_to_a_millimetre() -> None:
    frame = EnuFrame(47.05, 8.3, 0.0)
    rng = np.random.default_rng(1)
    azimuth, distance = rng.uniform(-180, 180, 20), rng.uniform(10, 1000, 20)
    lon, lat, _ = Geod(ellps="WGS84").fwd(np.full(20, 8.3), np.full(20, 47.05), azimuth, distance)
    enu = frame.enu_from_lla(lat, lon, np.zeros(20))
    np.testing.assert_allclose(np.hypot(*enu[:, :2].T), distance, atol=1e-3)
    np.testing.assert_allclose(enu[:, 2], -(distance**2) / (2 * 6.378e6), atol=1e-3)


def test_shapes() -> None:
    assert SITE.enu_from_lla(np.full(4, 47.0), 8.3, 400.0).shape == (4, 3)
    assert SITE.lla_from_enu(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("origin", [(91.0, 0.0, 0.0), (0.0, np.nan, 0.0), (512_345.0, 5.0, 0.0), (0.0, 0.0, np.inf)])
def test_origin_must_be_on_earth(origin: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="not on Earth"):
        EnuFrame(*origin)


@pytest.mark.parametrize(
    ("lat", "lon", "code"),
    [(47.0, 8.3, 32632), (-43.5, 172.5, 32759), (0.0, -180.0, 32601), (10.0, 180.0, 32601), (-1.0, 179.9, 32760)],
)
def test_the_utm_zone_of_the_origin(lat: float, lon: float, code: int) -> None:
    assert EnuFrame(lat, lon, 0.0).utm_zone == f"EPSG:{code}"
