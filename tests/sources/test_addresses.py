# SPDX-License-Identifier: Apache-2.0
"""What is an address, what of it may be written down, and what GDAL calls it."""

from __future__ import annotations

import pytest

from skymoor.sources.addresses import gdal_name, is_address, is_catalogue, is_template, public_address
from skymoor.sources.known import Facts, joined, known_facts
from skymoor.sources.tiles import HALF_WORLD_M, tile_service, zoom_of


@pytest.mark.parametrize(
    "text",
    [
        "https://a.org/b.tif",
        "HTTP://a.org/b.tif",
        "s3://bucket/b.tif",
        "/vsicurl/https://a.org/b.tif",
        "/vsis3/bucket/b.tif",
        "WMTS:https://a.org/cap.xml",
        "stac+https://a.org/v1.0",
    ],
)
def test_addresses(text: str) -> None:
    assert is_address(text)


@pytest.mark.parametrize("text", ["ortho.tif", "/data/ortho.tif", "C:/ortho.tif", "./https/ortho.tif", "/vsion.tif"])
def test_paths_are_none(text: str) -> None:
    assert not is_address(text)


def test_keys_are_not_shown() -> None:
    assert public_address("https://me:pw@a.org/b.tif?sig=KEY&x=1") == "https://a.org/b.tif"
    assert public_address("https://a.org/items/1?token=KEY#visual") == "https://a.org/items/1#visual"
    assert public_address("https://a.org/{z}/{x}/{y}.png?key=KEY") == "https://a.org/{z}/{x}/{y}.png"
    assert public_address("ortho.tif") == "ortho.tif"


def test_names_for_gdal_keep_the_query() -> None:
    assert gdal_name("https://a.org/b.tif?sig=KEY") == "/vsicurl/https://a.org/b.tif?sig=KEY"
    assert gdal_name("s3://bucket/b.tif") == "/vsis3/bucket/b.tif"
    assert gdal_name("/vsis3/bucket/b.tif") == "/vsis3/bucket/b.tif"


@pytest.mark.parametrize(
    ("text", "catalogue"),
    [
        ("https://a.org/v1/collections/naip", True),
        ("https://a.org/collections/naip/items/m_2022.v1", True),
        ("https://a.org/item.json", True),
        ("https://a.org/v1/search?collections=naip", True),
        ("stac+https://a.org/x.tif", True),
        ("https://a.org/b.tif", False),
        ("https://a.org/collections/b.tif", False),
        ("s3://a.org/item", False),
    ],
)
def test_what_is_read_as_stac(text: str, *, catalogue: bool) -> None:
    assert is_catalogue(text) is catalogue


def test_templates_have_all_three() -> None:
    assert is_template("https://a.org/{z}/{x}/{-y}.png") and is_template("https://a.org/?x={x}&y={y}&z={z}")
    assert not is_template("https://a.org/{z}/{x}.png") and not is_template("{x}/{y}/{z}.png")


@pytest.mark.parametrize(("pixel_m", "lat", "zoom"), [(0.6, 0.0, 18), (0.6, 60.0, 17), (0.29, 0.0, 20), (1e9, 0.0, 0)])
def test_the_coarsest_level_that_is_fine_enough(pixel_m: float, lat: float, zoom: int) -> None:
    assert zoom_of(pixel_m, lat) == zoom
    own_m = 2 * HALF_WORLD_M * {0.0: 1.0, 60.0: 0.5}[lat] / 256 / 2**zoom
    assert own_m <= pixel_m * 1.001 and (zoom == 0 or 2 * own_m > pixel_m)


def test_the_description_of_a_service_is_xml() -> None:
    assert "a.org/${z}/${x}/${y}?a=1&amp;b=2<" in tile_service("https://a.org/{z}/{x}/{y}?a=1&b=2", 3)


def test_known_sources_by_collection_or_file() -> None:
    found = known_facts("", "s3://copernicus-dem-30m/Copernicus_DSM_COG_10_N47_00_E008_00_DEM.tif")
    assert (found.vertical_datum, found.ce90, found.le90) == ("EPSG:3855", 6.0, 4.0)
    assert known_facts("https://a.org/survey.tif") == Facts()


def test_parts_agree_or_are_not_known() -> None:
    a = Facts("EPSG:3855", 1.0, 2.0, "CC0-1.0", "A", "2020-05-01")
    b = Facts("EPSG:5773", 1.0, None, "CC0-1.0", "B", "2021-06-01")
    assert joined([a, b]) == Facts(None, 1.0, None, "CC0-1.0", "A; B", "2020-05-01/2021-06-01")
    assert joined([a, a]) == a
