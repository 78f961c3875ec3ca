# SPDX-License-Identifier: Apache-2.0
"""Rasters of one analytic scene, written in many ways, must give one reference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from pyproj import Transformer
from rasterio.enums import ColorInterp
from rasterio.env import get_gdal_config

from skymoor.errors import InputError
from skymoor.geo.datum import ToEllipsoid
from skymoor.reference.raster import opened
from skymoor.reference.read import read_reference
from support.map_scene import (
    DEGREE_M,
    DSM_M,
    HEIGHT_PX,
    LAT,
    LON,
    ORTHO_M,
    WIDTH_PX,
    Array,
    assert_is_the_scene,
    layout,
    moved,
    positions,
    read,
    rewrite,
    truth,
    write,
    write_dsm,
    write_ortho,
)


@pytest.mark.parametrize(
    ("ortho", "dsm"),
    [
        (("EPSG:32632", "north-up"), ("EPSG:32632", "north-up")),
        (("EPSG:4326", "north-up"), ("EPSG:32632", "north-up")),
        (("EPSG:32632", "north-up"), ("EPSG:4326", "north-up")),
        (("EPSG:32632", "south-up"), ("EPSG:2056", "south-up")),
        (("EPSG:32632", "rotated"), ("EPSG:32631", "rotated")),
        (("EPSG:3857", "north-up"), ("EPSG:32633", "north-up")),
    ],
)
def test_every_layout_gives_the_scene(ortho: tuple[str, str], dsm: tuple[str, str], tmp_path: Path) -> None:
    reference = read(write_ortho(tmp_path, *ortho), write_dsm(tmp_path, *dsm))
    assert_is_the_scene(reference)
    assert reference.height.dtype == np.float32
    # Web Mercator's pixels are shorter on the ground, by the cosine of the latitude.
    shrink = np.cos(np.radians(LAT)) if ortho[0] == "EPSG:3857" else 1.0
    assert reference.grid.pixel_m == pytest.approx(ORTHO_M * shrink, rel=0.005)
    assert reference.dsm_pixel_m == pytest.approx(DSM_M, rel=0.005)
    # The origin is in the middle of the overlap, at the median height.
    assert reference.frame.lat_deg == pytest.approx(LAT, abs=3 / DEGREE_M)
    assert reference.frame.lon_deg == pytest.approx(LON, abs=3 / DEGREE_M)
    assert abs(np.nanmedian(reference.height)) < 0.5
    west, south, east, north = reference.grid.bounds
    assert abs(west + east) < 3
    assert abs(south + north) < 3


def test_earth_curvature_of_a_large_site(tmp_path: Path) -> None:
    # A flat ellipsoidal height bends down by 0.78 m at 3 km + 1 km from the middle.
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True).transform(LON, LAT)
    transform = rasterio.Affine(25.0, 0, x - 3000, 0, -25.0, y + 1000)
    ortho = write(tmp_path / "ortho.tif", np.full((3, 80, 240), 99, np.uint8), transform, "EPSG:32632")
    dsm = write(tmp_path / "dsm.tif", np.full((1, 80, 240), 1500, np.int16), transform, "EPSG:32632")
    reference = read(ortho, dsm)
    known = np.isfinite(reference.height)
    lla = reference.frame.lla_from_enu(np.column_stack([reference.grid.centres()[known], reference.height[known]]))
    np.testing.assert_allclose(lla[:, 2], 1500.0, atol=1e-3)
    assert -0.80 < np.nanmin(reference.height) < -0.70


def test_partial_overlap_is_the_extent(tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)
    with rasterio.open(dsm) as raster:
        heights, transform = raster.read()[:, :, 70:], moved(raster.transform, 70, 0)
    dsm.unlink()
    reference = read(ortho, write(dsm, heights, transform, "EPSG:32632"))
    assert_is_the_scene(reference)
    west, south, east, north = reference.grid.bounds
    assert east - west == pytest.approx(51, abs=1.5)  # 50 m and the little that true north adds
    assert north - south == pytest.approx(100, abs=1.5)


def test_coarser_grid_averages(tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path, pixel_m=0.25)
    noise = np.random.default_rng(0).normal(size=(400, 480)) * 2.0
    dsm = rewrite(dsm, lambda bands: (bands + noise).astype(np.float32))
    reference = read(ortho, dsm, pixel_m=2.0)
    assert reference.grid.pixel_m == 2.0
    _, up, known = truth(reference)
    # 64 DSM pixels per grid pixel; bilinear mixing of the blocks lowers the noise further, picking one would keep 2 m.
    assert 0.1 < np.std(reference.height[known] - up) < 0.27
    assert_is_the_scene(read(ortho, write_dsm(tmp_path), pixel_m=1.0), colour=4.0, height_m=0.03)


def test_never_finer_than_the_orthophoto_and_below_max_pixels(tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)
    assert read(ortho, dsm, pixel_m=0.1).grid.pixel_m == pytest.approx(ORTHO_M, rel=0.001)
    coarse = read(ortho, dsm, max_pixels=5000)
    assert 4000 < np.prod(coarse.grid.shape) <= 5100
    assert coarse.grid.pixel_m == pytest.approx(ORTHO_M * np.sqrt(WIDTH_PX * HEIGHT_PX / 5000), rel=0.03)


def test_tiles_leave_no_seam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)
    whole = read(ortho, dsm)
    monkeypatch.setattr("skymoor.reference.read.TILE_PX", 64)
    tiled = read(ortho, dsm)
    np.testing.assert_allclose(tiled.height, whole.height, atol=1e-4)
    np.testing.assert_array_equal(tiled.mask, whole.mask)
    assert np.abs(tiled.rgb.astype(int) - whole.rgb).max() <= 2


def test_sixteen_bit_and_float_are_stretched_alike(tmp_path: Path) -> None:
    dsm, plain = write_dsm(tmp_path), write_ortho(tmp_path)
    eight = read(plain, dsm)
    for change in (lambda bands: bands.astype(np.uint16) * 37 + 500, lambda bands: (bands / 255).astype(np.float32)):
        stretched = read(rewrite(write_ortho(tmp_path), change), dsm)
        a, b = eight.rgb[eight.mask].astype(float), stretched.rgb[eight.mask].astype(float)
        middle = (b > 5) & (b < 250)
        slope, intercept = np.polyfit(a[middle], b[middle], 1)
        low, high = np.percentile(a, [1, 99])
        assert slope == pytest.approx(255 / (high - low), rel=0.03)
        assert np.std(b[middle] - slope * a[middle] - intercept) < 1.0
        assert 0.005 < np.mean(b == 0) < 0.02


def test_grey_and_four_bands(tmp_path: Path) -> None:
    dsm = write_dsm(tmp_path)
    colour = read(write_ortho(tmp_path), dsm)
    grey = read(rewrite(tmp_path / "ortho.tif", lambda bands: bands[:1]), dsm)
    np.testing.assert_array_equal(grey.rgb, np.repeat(colour.rgb[..., :1], 3, axis=-1))
    write_ortho(tmp_path)
    infrared = rewrite(tmp_path / "ortho.tif", lambda b: np.concatenate([b, 0 * b[:1]]), photometric="RGB", alpha="no")
    four = read(infrared, dsm)
    np.testing.assert_array_equal(four.rgb, colour.rgb)
    np.testing.assert_array_equal(four.mask, colour.mask)


def test_bands_are_found_by_their_labels(tmp_path: Path) -> None:
    dsm = write_dsm(tmp_path)
    colour = read(write_ortho(tmp_path), dsm)
    path = rewrite(tmp_path / "ortho.tif", lambda b: np.concatenate([0 * b[:1], b[::-1]]))
    with rasterio.open(path, "r+") as raster:
        raster.colorinterp = [ColorInterp.undefined, ColorInterp.blue, ColorInterp.green, ColorInterp.red]
    np.testing.assert_array_equal(read(path, dsm).rgb, colour.rgb)


@pytest.mark.parametrize("kind", ["alpha", "grey and alpha", "nodata", "mask"])
def test_holes_of_the_orthophoto_are_masked_and_do_not_bleed(kind: str, tmp_path: Path) -> None:
    dsm, path = write_dsm(tmp_path), write_ortho(tmp_path)
    hole = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
    hole[60:140, 80:160] = True

    def with_hole(bands: NDArray[np.uint8]) -> NDArray[np.uint8]:
        bands = np.where(hole, 0, bands).astype(np.uint8)
        opaque = np.where(hole, 0, 255).astype(np.uint8)[None]
        if kind == "alpha":
            return np.concatenate([bands, opaque])
        return np.concatenate([bands[:1], opaque]) if kind == "grey and alpha" else bands

    profile: dict[str, Any] = {
        "alpha": {"ALPHA": "YES"},
        "grey and alpha": {"ALPHA": "YES"},
        "nodata": {"nodata": 0},
    }.get(kind, {})
    rewrite(path, with_hole, **profile)
    if kind == "mask":
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as raster:
            raster.write_mask(np.where(hole, 0, 255).astype(np.uint8))
    reference = read(path, dsm)
    area = (~reference.mask & np.isfinite(reference.height)).sum() * reference.grid.pixel_m**2
    assert area == pytest.approx(hole.sum() * ORTHO_M**2, rel=0.05)
    colours, _, known = truth(reference)
    columns = slice(0, 1) if kind == "grey and alpha" else slice(0, 3)
    # At the rim up to half of the weight is missing, which shifts the colour by at most half a pixel.
    assert np.abs(reference.rgb[known] - colours)[:, columns].max() < 12


@pytest.mark.parametrize("undeclared", [False, True])
def test_holes_of_the_dsm_take_their_neighbours_along(undeclared: bool, tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)

    def with_hole(bands: NDArray[np.float32]) -> NDArray[np.float32]:
        bands[:, 40:60, 50:80] = np.nan if undeclared else -9999
        return bands

    reference = read(ortho, rewrite(dsm, with_hole, **({} if undeclared else {"nodata": -9999})))
    assert_is_the_scene(reference)
    rim = ~np.isfinite(reference.height[8:-8, 8:-8])
    # Every pixel whose value would mix in the hole is unknown: half a DSM pixel more on each side, to the centres.
    assert rim.sum() * reference.grid.pixel_m**2 == pytest.approx((20 + 1) * (30 + 1), rel=0.04)


def test_dsm_of_scaled_integers_and_more_bands(tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)
    rewrite(dsm, lambda b: np.concatenate([np.rint((b - 400) * 100), 0 * b]).astype(np.int16))
    with rasterio.open(dsm, "r+") as raster:
        raster.scales, raster.offsets = (0.01, 1.0), (400.0, 0.0)
    assert_is_the_scene(read(ortho, dsm), height_m=0.015)


def test_vertical_datum_from_the_crs_or_stated(tmp_path: Path) -> None:
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)
    with pytest.raises(InputError, match=r"dsm\.tif: nothing says .* reference\.vertical_datum"):
        read(ortho, dsm, None)
    carrying = write_dsm(tmp_path, "EPSG:32632+3855")
    for stated in ("ellipsoid", "EPSG:5773"):
        with pytest.raises(InputError, match=rf"heights are EPSG:3855, but reference\.vertical_datum is {stated}"):
            read(ortho, carrying, stated)


def test_every_vertical_datum_goes_through_the_geoid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A sloping geoid and heights in feet, in place of grids that are not at hand.
    def fake(datum: str, lat: Array, lon: Array) -> Any:
        assert datum == "EPSG:3855"
        return ToEllipsoid(
            lambda lat, lon, height: np.asarray(height) * 0.3048 + 47.0 + (np.asarray(lat) - LAT) * 100.0
        )

    monkeypatch.setattr("skymoor.reference.heights.ellipsoid_from_datum", fake)
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path)
    lat = positions(*layout("EPSG:32632", DSM_M), "EPSG:32632")[0]
    rewrite(dsm, lambda bands: ((bands - 47.0 - (lat - LAT) * 100.0) / 0.3048).astype(np.float32))
    assert_is_the_scene(read(ortho, dsm, "EPSG:3855"))


class TestBadInput:
    """Each is one line that names the file."""

    @pytest.fixture
    def ortho(self, tmp_path: Path) -> Path:
        return write_ortho(tmp_path)

    @pytest.fixture
    def dsm(self, tmp_path: Path) -> Path:
        return write_dsm(tmp_path)

    def refused(self, ortho: Path, dsm: Path, message: str) -> None:
        with pytest.raises(InputError, match=message) as caught:
            read(ortho, dsm)
        assert "\n" not in str(caught.value)

    def test_missing_file(self, ortho: Path, dsm: Path, tmp_path: Path) -> None:
        self.refused(tmp_path / "nowhere.tif", dsm, r"nowhere\.tif: there is no such file")
        self.refused(ortho, tmp_path, "there is no such file")

    def test_not_a_raster(self, ortho: Path, dsm: Path) -> None:
        ortho.write_text("hello")
        self.refused(ortho, dsm, r"ortho\.tif: cannot be read")

    @pytest.mark.parametrize("name", ["ortho.tif", "dsm.tif"])
    def test_truncated(self, name: str, ortho: Path, dsm: Path, tmp_path: Path) -> None:
        path = tmp_path / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        self.refused(ortho, dsm, rf"{name}: cannot be read as a raster, is it complete")

    def test_no_position(self, ortho: Path, dsm: Path) -> None:
        with rasterio.open(ortho) as raster:
            bands = raster.read()
        ortho.unlink()
        with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
            write(ortho, bands, None, None)
        self.refused(ortho, dsm, r"ortho\.tif: the raster has no geotransform")

    def test_no_crs(self, ortho: Path, dsm: Path) -> None:
        write(dsm, np.zeros((1, 9, 9), np.float32), layout("EPSG:32632", 1.0)[0], None)
        self.refused(ortho, dsm, r"dsm\.tif: the raster has no coordinate reference system; assign it")

    def test_unknown_datum(self, ortho: Path, dsm: Path) -> None:
        write(dsm, np.zeros((1, 9, 9), np.float32), layout("EPSG:32632", 1.0)[0], "+proj=utm +zone=32 +ellps=bessel")
        self.refused(ortho, dsm, r"dsm\.tif: PROJ has no transformation")

    def test_no_overlap(self, ortho: Path, dsm: Path) -> None:
        write(dsm, np.zeros((1, 9, 9), np.float32), rasterio.Affine(1, 0, 600_000, 0, -1, 5_000_000), "EPSG:32632")
        self.refused(
            ortho, dsm, r"do not overlap: .*ortho\.tif covers latitude 47\.04.*; .*dsm\.tif covers latitude 45\.1"
        )

    def test_sliver_of_overlap(self, ortho: Path, dsm: Path) -> None:
        transform = moved(layout("EPSG:32632", 1.0)[0], 118, 0)
        write(dsm, np.full((1, 100, 90), 450, np.float32), transform, "EPSG:32632")
        self.refused(ortho, dsm, r"the area of the reference is only .* pixels")

    def test_nothing_but_nodata(self, ortho: Path, dsm: Path) -> None:
        rewrite(dsm, lambda bands: bands * 0 - 9999, nodata=-9999)
        self.refused(ortho, dsm, r"dsm\.tif: no valid height .*-9999")
        write_dsm(dsm.parent)
        rewrite(ortho, lambda bands: bands * 0, nodata=0)
        self.refused(ortho, dsm, r"ortho\.tif: no valid pixel")
        rewrite(ortho, lambda bands: bands.astype(np.uint16), nodata=0)
        self.refused(ortho, dsm, r"ortho\.tif: the orthophoto has no valid pixel")

    @pytest.mark.parametrize("value", [-32767.0, 3.4e38])
    def test_nodata_that_is_not_declared(self, value: float, ortho: Path, dsm: Path) -> None:
        def spoil(bands: NDArray[np.float32]) -> NDArray[np.float32]:
            bands[0, 31, 47] = value
            return bands

        rewrite(dsm, spoil)
        self.refused(ortho, dsm, r"dsm\.tif: 1 heights are impossible.*gdal_edit -a_nodata")

    def test_heights_in_centimetres(self, ortho: Path, dsm: Path) -> None:
        rewrite(dsm, lambda bands: bands * 100)
        self.refused(ortho, dsm, "convert the heights to metres")

    def test_covariance(self, ortho: Path, dsm: Path) -> None:
        with pytest.raises(InputError, match="positive definite"):
            read_reference(ortho, dsm, "ellipsoid", [[1, 2, 0], [2, 1, 0], [0, 0, 1]])


def test_the_cache_of_gdal_holds_whole_tiles(tmp_path: Path) -> None:
    """With less, every line of a tiled raster decodes its tiles again. rasterio takes a number for bytes."""
    path = write_ortho(tmp_path)
    with rasterio.Env(), opened(path):  # where there is an environment around it, its settings stay
        assert int(get_gdal_config("GDAL_CACHEMAX")) >= 64 * 2**20
