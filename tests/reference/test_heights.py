# SPDX-License-Identifier: Apache-2.0
"""Heights in any unit and datum, one height for a whole site, and none at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_HEIGHT_SIGMA_M, ce90_m
from skymoor.geo.datum import ToEllipsoid
from skymoor.geo.operations import Operation
from skymoor.geo.units import unit_m
from skymoor.reference.read import read_reference
from support.map_scene import (
    COVARIANCE,
    HEIGHT_PX,
    LAT,
    LON,
    ORTHO_M,
    WIDTH_PX,
    assert_is_the_scene,
    read,
    rewrite,
    write_dsm,
    write_ortho,
)

SURVEY_FOOT_M = 1200 / 3937


def dsm_in(folder: Path, unit: str | None, length_m: float, crs: str = "EPSG:32632") -> Path:
    """The scene's DSM with heights in a unit, which its band says or not."""
    path = rewrite(write_dsm(folder, crs), lambda bands: (bands / length_m).astype(np.float64))
    if unit is not None:
        with rasterio.open(path, "r+") as raster:
            raster.units = (unit,)
    return path


@pytest.mark.parametrize(
    ("names", "length_m"),
    [
        ("m, Metre, metres, METERS, [m], (m), m.", 1.0),
        ("ft, foot, Feet, [ft], International foot", 0.3048),
        ("us-ft, US Feet, US survey foot, US_survey_feet, ftUS, foot (US survey), Foot_US", SURVEY_FOOT_M),
        ("cm, centimetres", 0.01),
        ("mm, millimeter", 0.001),
        ("dm, decimetre, Decimeter", 0.1),
        ("km, kilometers", 1000.0),
        ("yd, yards", 0.9144),
        ("ind-ft", 0.30479841),
    ],
)
def test_units_by_their_usual_names(names: str, length_m: float) -> None:
    for name in names.split(", "):
        assert unit_m(name) == pytest.approx(length_m, rel=1e-14)


@pytest.mark.parametrize("name", ["", "furlong", "degree", "fms", "metric", "foo", "gpm", "unknown"])
def test_units_that_are_not_known(name: str) -> None:
    assert unit_m(name) is None


@pytest.mark.parametrize(
    ("unit", "length_m"),
    [("us-ft", SURVEY_FOOT_M), ("US Feet", SURVEY_FOOT_M), ("[ft]", 0.3048), ("Feet", 0.3048), ("cm", 0.01)],
)
def test_heights_in_other_units_are_converted_and_told(unit: str, length_m: float, tmp_path: Path) -> None:
    reference = read(write_ortho(tmp_path), dsm_in(tmp_path, unit, length_m))
    assert_is_the_scene(reference)
    (note,) = reference.notes
    assert "dsm.tif" in note and unit in note and "converted to metres" in note and "\n" not in note


@pytest.mark.parametrize("unit", [None, "m", "Metres", "[m]"])
def test_metres_need_no_note(unit: str | None, tmp_path: Path) -> None:
    reference = read(write_ortho(tmp_path), dsm_in(tmp_path, unit, 1.0))
    assert_is_the_scene(reference)
    assert reference.notes == ()


def test_unit_with_scale_and_offset(tmp_path: Path) -> None:
    """Tenths of feet above 1000 feet, in whole numbers."""
    path = rewrite(write_dsm(tmp_path), lambda bands: np.rint((bands / 0.3048 - 1000) * 10).astype(np.int32))
    with rasterio.open(path, "r+") as raster:
        raster.units, raster.scales, raster.offsets = ("ft",), (0.1,), (1000.0,)
    assert_is_the_scene(read(write_ortho(tmp_path), path), height_m=0.03)


def test_unknown_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"dsm\.tif: .*unknown unit 'furlong'.*gdal_edit -units") as caught:
        read(write_ortho(tmp_path), dsm_in(tmp_path, "furlong", 1.0))
    assert "\n" not in str(caught.value)


class TestUnitOfTheVerticalCrs:
    """NAVD88 in metres (EPSG:5703) and in US survey feet (EPSG:6360), with a geoid of 47 m in place of its grid."""

    @pytest.fixture(autouse=True)
    def geoid(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fake(datum: str, lat: Any, lon: Any) -> ToEllipsoid:
            foot = {"EPSG:6360": SURVEY_FOOT_M, "EPSG:5703": 1.0}[datum]
            return ToEllipsoid(lambda lat, lon, height: np.asarray(height) * foot + 47.0 + 0.0 * np.asarray(lat))

        monkeypatch.setattr("skymoor.reference.heights.ellipsoid_from_datum", fake)

    def feet(self, folder: Path, unit: str | None, crs: str = "EPSG:32632") -> Path:
        path = rewrite(write_dsm(folder, crs), lambda bands: ((bands - 47.0) / SURVEY_FOOT_M).astype(np.float64))
        if unit is not None:
            with rasterio.open(path, "r+") as raster:
                raster.units = (unit,)
        return path

    @pytest.mark.parametrize(
        ("crs", "unit", "datum"),
        [
            ("EPSG:32632+6360", None, None),
            ("EPSG:32632+6360", "us-ft", None),
            ("EPSG:32632", None, "EPSG:6360"),
            ("EPSG:32632", "US survey foot", "EPSG:6360"),
            ("EPSG:32632", "ft", "EPSG:6360"),  # for many programs all feet are one
            ("EPSG:32632", "us-ft", "EPSG:5703"),  # the datum says what heights refer to, the band their unit
        ],
    )
    def test_agreed(self, crs: str, unit: str | None, datum: str | None, tmp_path: Path) -> None:
        reference = read(write_ortho(tmp_path), self.feet(tmp_path, unit, crs), datum)
        assert_is_the_scene(reference)
        assert "converted to metres" in reference.notes[0]

    @pytest.mark.parametrize(
        ("crs", "unit", "datum"),
        [
            ("EPSG:32632+6360", "m", None),
            ("EPSG:32632", "metre", "EPSG:6360"),
            ("EPSG:32632+5703", "ft", None),
            ("EPSG:32632", "cm", "EPSG:6360"),
        ],
    )
    def test_contradiction(self, crs: str, unit: str, datum: str | None, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=rf"dsm\.tif: its band has heights in {unit}, but .*correct one of them"):
            read(write_ortho(tmp_path), self.feet(tmp_path, unit, crs), datum)


class TestAccuracyOfTransformations:
    """What PROJ states of its operations is added to the covariance, and told."""

    def test_exact_ones_add_nothing(self, tmp_path: Path) -> None:
        reference = read(write_ortho(tmp_path), write_dsm(tmp_path, "EPSG:4326"))
        np.testing.assert_array_equal(reference.covariance, COVARIANCE)
        assert reference.notes == ()

    def test_of_the_orthophoto(self, tmp_path: Path) -> None:
        # CH1903+ to WGS 84: EPSG says 1 m.
        reference = read(write_ortho(tmp_path, "EPSG:2056"), write_dsm(tmp_path))
        np.testing.assert_allclose(reference.covariance, COVARIANCE + np.diag([1.0, 1.0, 0.0]))
        (note,) = reference.notes
        assert "ortho.tif" in note and "CH1903+ to WGS 84" in note and "1 m" in note

    def test_of_the_dsm_counts_once(self, tmp_path: Path) -> None:
        for ortho in ("EPSG:2056", "EPSG:32632"):
            reference = read(write_ortho(tmp_path, ortho), write_dsm(tmp_path, "EPSG:2056"))
            np.testing.assert_allclose(reference.covariance, COVARIANCE + np.diag([1.0, 1.0, 0.0]))
            assert len(reference.notes) == 1

    def test_of_the_geoid(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        geoid = Operation("EGM2008", 1.0, 1.0, 0.3, ("better.tif",))
        conversion = ToEllipsoid(lambda lat, lon, height: np.asarray(height) + 0.0 * np.asarray(lat), geoid)
        monkeypatch.setattr("skymoor.reference.heights.ellipsoid_from_datum", lambda *_: conversion)
        reference = read(write_ortho(tmp_path), write_dsm(tmp_path), "EPSG:3855")
        np.testing.assert_allclose(reference.covariance, COVARIANCE + np.diag([0.0, 0.0, 1.0]))
        (note,) = reference.notes
        assert "EGM2008" in note and "`skymoor grids fetch better.tif`" in note


class TestOneHeight:
    def test_is_that_height_everywhere(self, tmp_path: Path) -> None:
        reference = read_reference(write_ortho(tmp_path), 412.5, "ellipsoid", COVARIANCE)
        assert np.isfinite(reference.height).all() and reference.frame.height_m == pytest.approx(412.5)
        plan = reference.grid.centres().reshape(-1, 2)
        lla = reference.frame.lla_from_enu(np.column_stack([plan, reference.height.ravel()]))
        np.testing.assert_allclose(lla[:, 2], 412.5, atol=1e-3)
        assert reference.dsm_pixel_m == np.inf and reference.has_heights and not reference.has_relief
        np.testing.assert_array_equal(reference.covariance, COVARIANCE)

    def test_goes_through_the_geoid_in_metres(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        conversion = ToEllipsoid(lambda lat, lon, h: np.asarray(h) * SURVEY_FOOT_M + 47.0 + 0.0 * np.asarray(lat))
        monkeypatch.setattr("skymoor.reference.heights.ellipsoid_from_datum", lambda *_: conversion)
        reference = read_reference(write_ortho(tmp_path), 100.0, "EPSG:6360", COVARIANCE)
        assert reference.frame.height_m == pytest.approx(147.0)
        assert "100 m above EPSG:6360" in reference.notes[0]

    def test_needs_a_datum_and_must_be_possible(self, tmp_path: Path) -> None:
        ortho = write_ortho(tmp_path)
        with pytest.raises(InputError, match=r"reference\.dsm = 100: nothing says which vertical datum"):
            read_reference(ortho, 100.0, None, COVARIANCE)
        for height in (-9999.0, 12_000.0):
            with pytest.raises(InputError, match="no land is at this height"):
                read_reference(ortho, height, "ellipsoid", COVARIANCE)


def test_no_heights_at_all(tmp_path: Path) -> None:
    correlated = COVARIANCE + np.array([[0, 0.2, 0.3], [0.2, 0, 0.1], [0.3, 0.1, 0]])
    reference = read_reference(write_ortho(tmp_path), None, None, correlated)
    assert not reference.has_heights and not reference.has_relief and reference.dsm_pixel_m == np.inf
    assert reference.frame.height_m == 0.0
    assert reference.frame.lat_deg == pytest.approx(LAT, abs=1e-5)
    assert reference.frame.lon_deg == pytest.approx(LON, abs=1e-5)
    west, south, east, north = reference.grid.bounds
    assert (east - west, north - south) == pytest.approx((WIDTH_PX * ORTHO_M, HEIGHT_PX * ORTHO_M), abs=2.5)
    assert reference.mask.mean() > 0.95
    np.testing.assert_allclose(reference.covariance[:2, :2], correlated[:2, :2])
    np.testing.assert_array_equal(reference.covariance[2], [0, 0, UNKNOWN_HEIGHT_SIGMA_M**2])
    assert ce90_m(reference.covariance) == pytest.approx(ce90_m(correlated))
    assert "ortho.tif" in reference.notes[0] and "--dsm" in reference.notes[0]
