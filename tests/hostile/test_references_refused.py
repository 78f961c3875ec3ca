# SPDX-License-Identifier: Apache-2.0
"""References that are none, or not usable: one line that names the file and the mend."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from PIL import Image

from support.tiny_site import EAST_M, NORTH_M, SITE, Case, assert_refused, make_site, picture, write_raster

FLAT = np.full((1, 80, 80), 10, np.float32)


def raster(name: str, bands: NDArray[Any], **profile: Any) -> Callable[[Path], None]:
    """In place of the site's, with another profile."""

    def write(site: Path) -> None:
        count, height, width = bands.shape
        plain = {"crs": "EPSG:32617", "transform": Affine(0.5, 0, EAST_M, 0, -0.5, NORTH_M), "dtype": bands.dtype}
        sizes = {"driver": "GTiff", "count": count, "height": height, "width": width}
        with rasterio.open(site / name, "w", **{**plain, **sizes, **profile}) as file:
            file.write(bands)

    return write


def said(name: str, **what: Any) -> Callable[[Path], None]:
    """The site's raster with another thing said of its band."""

    def write(site: Path) -> None:
        with rasterio.open(site / name, "r+") as file:
            for key, value in what.items():
                setattr(file, key, value)

    return write


def content(name: str, what: bytes | Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def write(site: Path) -> None:
        path = site / name
        path.write_bytes(what(path.read_bytes()) if callable(what) else what)

    return write


def toml(old: str, new: str) -> Callable[[Path], None]:
    def write(site: Path) -> None:
        assert old in SITE
        (site / "site.toml").write_text(SITE.replace(old, new), encoding="utf-8")

    return write


def swapped(site: Path) -> None:
    (site / "ortho.tif").rename(site / "x")
    (site / "dsm.tif").rename(site / "ortho.tif")
    (site / "x").rename(site / "dsm.tif")


def giants(site: Path) -> None:
    """Ten gigapixels each, of which nothing is stored."""
    for name, count, kind in (("ortho.tif", 3, np.uint8), ("dsm.tif", 1, np.float32)):
        profile = {"driver": "GTiff", "count": count, "dtype": kind, "crs": "EPSG:32617", "tiled": True}
        place = Affine(0.01, 0, EAST_M, 0, -0.01, NORTH_M)
        with rasterio.open(
            site / name, "w", height=100_000, width=100_000, transform=place, SPARSE_OK=True, BIGTIFF="YES", **profile
        ) as file:
            file.write(np.full((count, 16, 16), 10, kind), window=rasterio.windows.Window(0, 0, 16, 16))


def one_piece(site: Path) -> None:
    """Compressed as one tile: 900 MB to read a pixel."""
    profile = {"driver": "GTiff", "count": 1, "dtype": np.uint8, "crs": "EPSG:32617", "compress": "deflate"}
    place = Affine(0.01, 0, EAST_M, 0, -0.01, NORTH_M)
    side = 30_000
    tiles = {"tiled": True, "blockxsize": side, "blockysize": side, "SPARSE_OK": True}
    with rasterio.open(site / "ortho.tif", "w", height=side, width=side, transform=place, **tiles, **profile):
        pass


def a_photo(site: Path) -> None:
    Image.fromarray(picture(0, 80, 80)).save(site / "ortho.tif", "JPEG")


def broken_vrt(site: Path) -> None:
    (site / "dsm.vrt").write_text(
        '<VRTDataset rasterXSize="80" rasterYSize="80"><SRS>EPSG:32617</SRS>'
        f"<GeoTransform>{EAST_M}, 0.5, 0, {NORTH_M}, 0, -0.5</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">gone.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    toml("dsm.tif", "dsm.vrt")(site)


def position(*six: float) -> dict[str, Affine]:
    return {"transform": Affine(*six)}


def tie_points(site: Path) -> None:
    points = [rasterio.control.GroundControlPoint(r, c, EAST_M + c, NORTH_M - r) for r, c in ((0, 0), (0, 9), (9, 0))]
    profile = {"driver": "GTiff", "count": 1, "height": 80, "width": 80, "dtype": np.float32}
    with rasterio.open(site / "dsm.tif", "w", gcps=points, crs="EPSG:32617", **profile) as file:
        file.write(FLAT)


def text_of_no_code(site: Path) -> None:
    """GDAL repeats it in its message."""
    (site / "dsm.vrt").write_bytes(b"<VRTDataset rasterXSize='\xed\xa0\x80'>")
    toml("dsm.tif", "dsm.vrt")(site)


def sheared(site: Path) -> None:
    """A world file without end in one number."""
    Image.fromarray(picture(0, 80, 80)).save(site / "ortho.png")
    (site / "ortho.pgw").write_text(f"0.5\n{10**25}\n0\n-0.5\n{EAST_M}\n{NORTH_M}\n")
    srs = rasterio.crs.CRS.from_epsg(32617).to_wkt()
    (site / "ortho.png.aux.xml").write_text(f"<PAMDataset><SRS>{srs}</SRS></PAMDataset>")
    toml("ortho.tif", "ortho.png")(site)


def pipe_beside(site: Path) -> None:
    os.mkfifo(site / "dsm.tif.aux.xml")


PIXEL = np.full((3, 1, 1), 99, np.uint8)
CASES = [
    Case("ortho of one pixel", raster("ortho.tif", PIXEL), ("ortho.tif", "only 0.5 m by 0.5 m")),
    Case("dsm of one pixel", raster("dsm.tif", FLAT[:, :1, :1]), ("ortho.tif", "the area of the reference is only")),
    Case("dsm of one row", raster("dsm.tif", FLAT[:, :1]), ("the area of the reference is only 40.0 m by 0.5 m",)),
    Case("dsm of nan", raster("dsm.tif", FLAT * np.nan), ("dsm.tif", "no valid height")),
    Case("dsm of inf", raster("dsm.tif", FLAT * np.inf), ("dsm.tif", "no valid height")),
    Case("dsm of nodata", raster("dsm.tif", FLAT * 0 - 9999, nodata=-9999), ("dsm.tif", "no valid height", "-9999")),
    Case("nodata not declared", raster("dsm.tif", FLAT * 0 - 32768), ("dsm.tif", "gdal_edit -a_nodata")),
    Case("ortho of nan", raster("ortho.tif", FLAT * np.nan), ("ortho.tif", "no valid pixel")),
    Case("complex ortho", raster("ortho.tif", FLAT.astype(np.complex64)), ("ortho.tif", "complex")),
    Case("complex dsm", raster("dsm.tif", FLAT.astype(np.complex64)), ("dsm.tif", "complex")),
    Case("ortho and dsm swapped", swapped, ("dsm.tif", "an image, not heights", "orthophoto?")),
    Case("one file for both", toml('"dsm.tif"', '"ortho.tif"'), ("ortho.tif", "give two files")),
    Case("scale of zero", said("dsm.tif", scales=(0.0,)), ("dsm.tif", "scale 0")),
    Case("scale of nan", said("dsm.tif", scales=(np.nan,)), ("dsm.tif", "scale nan")),
    Case("heights in furlongs", said("dsm.tif", units=("furlong",)), ("dsm.tif", "furlong", "gdal_edit -units")),
    Case("ten gigapixels twice", giants, ("100000 by 100000", "gdal_translate -projwin")),
    Case("one tile of 900 megapixels", one_piece, ("ortho.tif", "in one block of 900 MB", "TILED=YES")),
    Case(
        "geocentric", raster("dsm.tif", FLAT, crs="EPSG:4978"), ("dsm.tif", "neither projected nor geographic", "warp")
    ),
    Case("at nan", raster("dsm.tif", FLAT, **position(0.5, 0, np.nan, 0, -0.5, 3e6)), ("dsm.tif", "check both")),
    Case("at infinity", raster("dsm.tif", FLAT, **position(0.5, 0, 1e300, 0, -0.5, 3e6)), ("dsm.tif", "check both")),
    Case("pixels of no size", raster("dsm.tif", FLAT, **position(0.5, 0, 5e5, 0, 0, 3e6)), ("dsm.tif", "geotransform")),
    Case("pixels of a millionth", raster("dsm.tif", FLAT, **position(1e-6, 0, 5e5, 0, -1e-6, 3e6)), ("overlap",)),
    Case("tie points only", tie_points, ("dsm.tif", "no geotransform", "gdalwarp")),
    Case("elsewhere", raster("dsm.tif", FLAT, **position(0.5, 0, 9e5, 0, -0.5, 3e6)), ("do not overlap", "dsm.tif")),
    Case("no crs", lambda site: write_raster(site / "ortho.tif", FLAT, crs=None), ("ortho.tif", "no geotransform")),
    Case("a photo", a_photo, ("ortho.tif", "no geotransform", "GeoTIFF")),
    Case("nothing", content("dsm.tif", b""), ("dsm.tif", "cannot be read as a raster")),
    Case("head only", content("dsm.tif", lambda all_: all_[:8]), ("dsm.tif", "cannot be read as a raster")),
    Case("half", content("ortho.tif", lambda all_: all_[: len(all_) // 2]), ("ortho.tif", "is it complete")),
    Case("a zip", content("dsm.tif", b"PK\3\4" + bytes(99)), ("dsm.tif", "cannot be read as a raster")),
    Case("vrt of what is gone", broken_vrt, ("dsm.vrt", "is it complete")),
    Case("vrt in no code of letters", text_of_no_code, ("dsm.vrt", "cannot be read as a raster")),
    Case("pixels without size", sheared, ("ortho.png", "check the geotransform or world file")),
    Case("a pipe beside it", pipe_beside, ("dsm.tif.aux.xml", "is a pipe", "remove it")),
    Case("a folder", toml('"dsm.tif"', '"airborne"'), ("site.toml", "reference.dsm", "no file")),
    Case("horizontal datum", toml('"ellipsoid"', '"EPSG:32617"'), ("EPSG:32617", "no vertical datum")),
    Case("no datum", toml('"ellipsoid"', '"sea level"'), ("sea level", "EPSG:3855")),
    Case("datum not said", toml('vertical_datum = "ellipsoid"', ""), ("dsm.tif", "reference.vertical_datum")),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_refused(case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert_refused(make_site(tmp_path), case, lambda: capsys.readouterr().err)


def test_a_raster_of_which_a_part_is_lost_is_never_half_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cut off after every eighth of its bytes, tiles and all."""
    site = make_site(tmp_path)
    for name, bands in (
        ("ortho.tif", np.random.default_rng(0).integers(1, 255, (3, 80, 80), np.uint8)),
        ("dsm.tif", FLAT),
    ):
        raster(name, bands, tiled=True, blockxsize=16, blockysize=16, compress="deflate")(site)
        whole = (site / name).read_bytes()
        for share in range(1, 8):
            (site / name).write_bytes(whole[: len(whole) * share // 8])
            assert_refused(site, Case("", lambda _: None, (name,)), lambda: capsys.readouterr().err)
        (site / name).write_bytes(whole)
