# SPDX-License-Identifier: Apache-2.0
"""A reference from a server on this machine is the same pixels as its source, from a part of its bytes, or nothing."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.io import DatasetReader
from rasterio.windows import Window

from skymoor.errors import InputError
from skymoor.pipeline.site import load_site
from skymoor.sources import mosaic
from skymoor.sources.fetch import fetch_reference
from support.web import Web
from support.web_rasters import box, write_dsm, write_ortho


def same_pixels(part: Path, whole: Path) -> bool:
    """Whether a raster is a part of another, pixel for pixel."""
    with rasterio.open(part) as a, rasterio.open(whole) as b:
        same = (a.crs, a.dtypes, a.nodata) == (b.crs, b.dtypes, b.nodata)
        return same and np.array_equal(a.read(), b.read(window=window_of(a, b)))


def window_of(part: DatasetReader, whole: DatasetReader) -> Window:
    """Where a raster lies in another, whose pixels it shares."""
    left, top = (
        (part.bounds.left - whole.bounds.left) / whole.res[0],
        (whole.bounds.top - part.bounds.top) / whole.res[1],
    )
    assert part.res == whole.res and np.allclose([left, top], np.round([left, top]), atol=1e-6)
    return Window(round(left), round(top), part.width, part.height)


def test_a_window_is_copied_and_not_the_file(web: Web, tmp_path: Path) -> None:
    found = fetch_reference(web.url("ortho.tif"), web.url("dsm.tif"), tmp_path, bbox=box())
    assert found.dsm is not None
    assert same_pixels(found.ortho, web.folder / "ortho.tif") and same_pixels(found.dsm, web.folder / "dsm.tif")
    with rasterio.open(found.ortho) as ortho:
        assert 200 <= ortho.width <= 210 and 200 <= ortho.height <= 210
    assert web.sent["ortho.tif"] < 0.15 * (web.folder / "ortho.tif").stat().st_size
    assert found.facts.vertical_datum == "EPSG:3855"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dsm.tif", "ortho.tif", "reference.toml"]


def test_a_file_on_this_machine_is_a_source_too(web: Web, tmp_path: Path) -> None:
    folder = web.folder
    fetch_reference(str(folder / "ortho.tif"), str(folder / "dsm.tif"), tmp_path, bbox=box(100.0))
    found = fetch_reference(str(folder / "ortho.tif"), None, tmp_path, bbox=box())
    assert not (tmp_path / "dsm.tif").exists()
    assert same_pixels(found.ortho, folder / "ortho.tif") and found.dsm is None
    assert not web.seen


def test_everything_without_a_box_and_heights_as_the_image(web: Web, tmp_path: Path) -> None:
    write_ortho(web.folder / "small.tif", left_m=300.0, side=128)
    found = fetch_reference(web.url("small.tif"), web.url("dsm.tif"), tmp_path)
    assert found.dsm is not None and same_pixels(found.ortho, web.folder / "small.tif")
    with rasterio.open(found.ortho) as ortho, rasterio.open(found.dsm) as dsm:
        assert ortho.shape == (128, 128)
        assert np.allclose(dsm.bounds, ortho.bounds, atol=4.0)


def test_an_overview_where_it_is_fine_enough(web: Web, tmp_path: Path) -> None:
    found = fetch_reference(web.url("ortho.tif"), None, tmp_path, bbox=box(), pixel_m=1.3)
    with rasterio.open(found.ortho) as ortho, rasterio.open(web.folder / "ortho.tif", overview_level=0) as coarse:
        assert ortho.res == (1.0, 1.0)
        assert np.array_equal(ortho.read(), coarse.read(window=window_of(ortho, coarse)))


def test_a_mosaic_of_the_user(web: Web, tmp_path: Path) -> None:
    (web.folder / "mosaic.vrt").write_text(_vrt([web.folder / "ortho.tif", web.folder / "east.tif"]))
    found = fetch_reference(web.url("mosaic.vrt"), None, tmp_path, bbox=box(left_m=450.0))
    with rasterio.open(found.ortho) as got, rasterio.open(web.folder / "ortho.tif") as west:
        window, seam = window_of(got, west), round((500_500.0 - got.bounds.left) / 0.5)
        assert 0 < seam < got.width
        own = Window(window.col_off, window.row_off, seam, window.height)
        assert np.array_equal(got.read()[..., :seam], west.read(window=own))
        assert (got.read()[..., seam:] > 0).all()


def test_a_bucket(web: Web, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (web.folder / "bucket").mkdir(exist_ok=True)
    write_ortho(web.folder / "bucket" / "ortho.tif")
    settings = {"S3_ENDPOINT": f"127.0.0.1:{web.port}", "HTTPS": "NO", "VIRTUAL_HOSTING": "FALSE"}
    for name, value in settings.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    monkeypatch.setenv("AWS_NO_SIGN_REQUEST", "YES")
    found = fetch_reference("s3://bucket/ortho.tif", None, tmp_path, bbox=box())
    assert same_pixels(found.ortho, web.folder / "bucket" / "ortho.tif")


def test_the_table_is_that_of_a_site(web: Web, tmp_path: Path) -> None:
    source = write_dsm(web.folder / "Copernicus_DSM_test.tif", crs="EPSG:32632")
    found = fetch_reference(
        web.url("ortho.tif?key=SECRET"), web.url(source.name + "?key=SECRET"), tmp_path / "place", bbox=box()
    )
    table = tomllib.loads(found.table.read_text())["reference"]
    assert (table["ortho"], table["dsm"], table["vertical_datum"]) == ("ortho.tif", "dsm.tif", "EPSG:3855")
    # The heights' accuracy is known, that of the orthophoto is not.
    assert table["accuracy"] == "unknown" and "LE90 of the source: 4.0 m" in found.table.read_text()
    assert "Airbus" in table["credit"] and "Copernicus" in table["licence"]
    with rasterio.open(tmp_path / "place" / "dsm.tif") as dsm:
        assert "Airbus" in dsm.tags()["TIFFTAG_COPYRIGHT"]
    for path in (tmp_path / "place").iterdir():
        assert b"SECRET" not in path.read_bytes()


def test_with_the_photos_it_is_a_site(web: Web, tmp_path: Path) -> None:
    found = fetch_reference(web.url("ortho.tif"), web.url("dsm.tif"), tmp_path, bbox=box())
    (tmp_path / "photos").mkdir()
    stated = found.table.read_text().replace('accuracy = "unknown"', "ce90 = 2.0\nle90 = 3.0")
    (tmp_path / "site.toml").write_text(stated.replace("# [airborne]", "[airborne]").replace("# images", "images"))
    site = load_site(tmp_path / "site.toml")
    assert site.reference.vertical_datum == "EPSG:3855" and site.reference.ortho == tmp_path / "ortho.tif"


def test_no_nodata_and_no_mask_is_declared_that_the_source_has_not(web: Web, tmp_path: Path) -> None:
    found = fetch_reference(web.url("ortho.tif"), None, tmp_path, bbox=box())
    with rasterio.open(found.ortho) as ortho:
        assert ortho.nodata is None and ortho.mask_flag_enums[0] == [rasterio.enums.MaskFlags.all_valid]


def test_a_mask_is_kept(web: Web, tmp_path: Path) -> None:
    masked, source = web.folder / "masked.tif", web.folder / "ortho.tif"
    with rasterio.open(source) as plain:
        values, profile, mask = plain.read(), {**plain.profile, "driver": "GTiff"}, np.full(plain.shape, 255, np.uint8)
    mask[450:500] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(masked, "w", **profile) as file:
        file.write(values)
        file.write_mask(mask)
    found = fetch_reference(web.url("masked.tif"), None, tmp_path, bbox=box())
    with rasterio.open(found.ortho) as got, rasterio.open(masked) as whole:
        assert np.array_equal(got.dataset_mask(), whole.dataset_mask(window=window_of(got, whole)))
        assert 0 < (got.dataset_mask() == 0).mean() < 0.5


FAILURES: dict[str, tuple[str, dict[str, Any], str]] = {
    "nothing there": ("none.tif", {}, "HTTP status 404: there is nothing at this address"),
    "no credentials": ("ortho.tif", {"refuse": {"ortho.tif": 401}}, "HTTP status 401: it asks for credentials"),
    "no access": ("ortho.tif", {"refuse": {"ortho.tif": 403}}, "HTTP status 403: access is denied"),
    "broken server": ("ortho.tif", {"refuse": {"ortho.tif": 500}}, "HTTP status 500: the server failed"),
    "no answer": ("ortho.tif", {"stall_s": 1.5}, "no answer within 1 s"),
    "a connection that breaks": ("ortho.tif", {"halve": ["ortho.tif"]}, "broke off"),
    "half a file": ("half.tif", {}, "broke off"),
    "no raster": ("page.tif", {}, "cannot be read as a raster"),
}


@pytest.mark.parametrize("case", FAILURES)
def test_a_failure_is_one_line_and_leaves_nothing(web: Web, tmp_path: Path, case: str) -> None:
    name, trouble, told = FAILURES[case]
    content = (web.folder / "ortho.tif").read_bytes()
    (web.folder / "half.tif").write_bytes(content[: len(content) // 2])
    (web.folder / "page.tif").write_text("<html>Sign in</html>" * 50)
    web.behave(**trouble)
    with pytest.raises(InputError) as error:
        fetch_reference(web.url(name) + "?key=SECRET", None, tmp_path / "out", bbox=box())
    message = str(error.value)
    assert message.startswith(web.url(name) + ": ") and told in message
    assert "SECRET" not in message and "\n" not in message
    assert not (tmp_path / "out").exists()


def test_what_was_there_survives_a_failure(web: Web, tmp_path: Path) -> None:
    fetch_reference(web.url("ortho.tif"), None, tmp_path, bbox=box())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    web.behave(refuse={"dsm.tif": 503})
    with pytest.raises(InputError, match="503"):
        fetch_reference(web.url("ortho.tif"), web.url("dsm.tif"), tmp_path, bbox=box(100.0))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_no_server(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^http://127\.0\.0\.1:9/a\.tif: cannot be reached"):
        fetch_reference("http://127.0.0.1:9/a.tif?key=SECRET", None, tmp_path)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"bbox": (1.0, 2.0, 3.0, 4.0)}, "lies outside of the bounding box; it covers longitude 9.0"),
        ({"bbox": (9.1, 46.0, 9.0, 47.0)}, "west below east"),
        ({"bbox": (float("nan"), 46.0, 9.0, 47.0)}, "west below east"),
        ({"dsm": "nowhere.tif"}, "nowhere.tif: there is no such file, and it is no address"),
        ({"dsm": "ORTHO"}, "is an image and holds no heights"),
    ],
)
def test_wrong_requests(web: Web, tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    given: dict[str, Any] = {"ortho": web.url("ortho.tif"), "dsm": None, "bbox": box(), **changes}
    given["dsm"] = web.url("ortho.tif") if given["dsm"] == "ORTHO" else given["dsm"]
    with pytest.raises(InputError, match=told):
        fetch_reference(out=tmp_path / "out", **given)
    assert not (tmp_path / "out").exists()


def test_too_many_pixels(web: Web, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mosaic, "LARGEST_PX", 1e4)
    with pytest.raises(InputError, match=r"pixels would be fetched, at most 10000 are; give a smaller"):
        fetch_reference(web.url("ortho.tif"), None, tmp_path / "out", bbox=box())


def test_files_of_others_stay(web: Web, tmp_path: Path) -> None:
    (tmp_path / "dsm.tif").write_text("mine")
    with pytest.raises(InputError, match=r"dsm\.tif: is not of this command"):
        fetch_reference(web.url("ortho.tif"), None, tmp_path, bbox=box())
    assert not web.seen and (tmp_path / "dsm.tif").read_text() == "mine"


def _vrt(files: list[Path]) -> str:
    """A mosaic of rasters that lie beside it, each 1000 pixels wide, from west to east."""
    with rasterio.open(files[0]) as first:
        crs, t = first.crs.to_wkt(), first.transform
    bands = ""
    for band in (1, 2, 3):
        sources = "".join(
            f'<SimpleSource><SourceFilename relativeToVRT="1">{file.name}</SourceFilename>'
            f"<SourceBand>{band}</SourceBand>"
            f'<SrcRect xOff="0" yOff="0" xSize="1000" ySize="1000"/>'
            f'<DstRect xOff="{1000 * k}" yOff="0" xSize="1000" ySize="1000"/></SimpleSource>'
            for k, file in enumerate(files)
        )
        bands += f'<VRTRasterBand dataType="Byte" band="{band}">{sources}</VRTRasterBand>'
    transform = f"{t.c}, {t.a}, 0, {t.f}, 0, {t.e}"
    return (
        f'<VRTDataset rasterXSize="{1000 * len(files)}" rasterYSize="1000"><SRS>{crs.replace("&", "&amp;")}</SRS>'
        f"<GeoTransform>{transform}</GeoTransform>{bands}</VRTDataset>"
    )
