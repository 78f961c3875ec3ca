# SPDX-License-Identifier: Apache-2.0
"""STAC items, static collections, and an API on this machine: the newest that covers the place, and its asset."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.vrt import WarpedVRT

from skymoor.errors import InputError
from skymoor.sources.fetch import FetchedReference, fetch_reference
from support.web import Web
from support.web_rasters import box, collection, item, write_ortho, write_static_catalogue

API = "https://api.stacspec.org/v1.0.0"


@pytest.fixture
def catalogue(web: Web) -> Web:
    """collection.json with old.json, which shows the west and the middle, and new.json, which shows the east."""
    old = item("old", web.folder / "ortho.tif", "2020-05-01T00:00:00Z")
    middle = write_ortho(web.folder / "middle.tif", left_m=250.0, seed=5)
    new = item("new", middle, "2022-06-01T00:00:00Z")
    write_static_catalogue(web.folder, [old, new])
    return web


def fetched(web: Web, path: str, out: Path, **options: Any) -> FetchedReference:
    return fetch_reference(web.url(path), None, out, **{"bbox": box(), **options})


def test_an_item_says_licence_credit_and_date(catalogue: Web, tmp_path: Path) -> None:
    facts = fetched(catalogue, "old.json", tmp_path).facts
    assert (facts.licence, facts.credit, facts.date) == ("CC-BY-4.0", "Survey of Nowhere", "2020-05-01")
    assert 'date = "2020-05-01"' in (tmp_path / "reference.toml").read_text()


def test_the_newest_counts_and_others_fill_the_rest(catalogue: Web, tmp_path: Path) -> None:
    found = fetched(catalogue, "collection.json", tmp_path)
    assert found.facts.date == "2020-05-01/2022-06-01" and "2 rasters" in found.notes[0]
    with rasterio.open(found.ortho) as got:
        values, left = got.read(), got.bounds.left - 500_000.0
    top = round((5_200_000.0 - got.bounds.top) * 2)
    with rasterio.open(catalogue.folder / "ortho.tif") as old, rasterio.open(catalogue.folder / "middle.tif") as new:
        seam = round((250.0 - left) * 2)
        rows, first = slice(top, top + values.shape[1]), round(left * 2)
        assert 0 < seam < values.shape[2]
        assert np.array_equal(values[..., :seam], old.read()[:, rows, first : first + seam])
        assert np.array_equal(values[..., seam:], new.read()[:, rows, : values.shape[2] - seam])


def test_what_the_newest_covers_is_not_read_twice(catalogue: Web, tmp_path: Path) -> None:
    found = fetched(catalogue, "collection.json", tmp_path, bbox=box(left_m=380.0, side_m=60.0))
    assert found.facts.date == "2022-06-01" and "ortho.tif" not in catalogue.sent


def test_a_time_chooses(catalogue: Web, tmp_path: Path) -> None:
    assert fetched(catalogue, "collection.json", tmp_path, date="2020-01/2021").facts.date == "2020-05-01"
    with pytest.raises(InputError, match=r"has no item in the bounding box and the time 2019; check both"):
        fetched(catalogue, "collection.json", tmp_path, date="2019")


def test_another_crs_is_laid_on_the_first(catalogue: Web, tmp_path: Path) -> None:
    with rasterio.open(catalogue.folder / "ortho.tif") as source, WarpedVRT(source, crs="EPSG:25833") as warped:
        profile, values = {**warped.profile, "driver": "GTiff"}, warped.read()
    with rasterio.open(catalogue.folder / "zone33.tif", "w", **profile) as file:
        file.write(values)
    items = [
        item("zone33", catalogue.folder / "zone33.tif", "2019-01-01T00:00:00Z"),
        item("new", catalogue.folder / "middle.tif", "2022-06-01T00:00:00Z"),
    ]
    write_static_catalogue(catalogue.folder, items)
    found = fetched(catalogue, "collection.json", tmp_path)
    with rasterio.open(found.ortho) as got:
        assert got.crs.to_epsg() == 32632 and got.res == (0.5, 0.5)
        assert (got.dataset_mask() > 0).mean() > 0.99


def test_assets_by_what_they_are_or_by_name(catalogue: Web, tmp_path: Path) -> None:
    one = item("many", catalogue.folder / "ortho.tif", "2020-05-01T00:00:00Z")
    raster = {"type": "image/tiff; application=geotiff; profile=cloud-optimized"}
    one["assets"] = {
        "nir": {**raster, "href": "./none.tif", "roles": ["data"]},
        "scene": {**raster, "href": "./ortho.tif", "eo:bands": [{"common_name": c} for c in ("red", "green", "blue")]},
        "dsm_2m": {**raster, "href": "./dsm.tif", "gsd": 2},
        "dsm_1m": {**raster, "href": "./dsm.tif", "gsd": 1},
    }
    (catalogue.folder / "many.json").write_text(json.dumps(one))
    address = catalogue.url("many.json")
    found = fetch_reference(address, address, tmp_path, bbox=box())
    assert found.dsm is not None and found.facts.vertical_datum == "EPSG:3855"
    fetch_reference(address + "#sc*", address + "#dsm_2m", tmp_path, bbox=box())
    del one["assets"]["scene"], one["assets"]["dsm_1m"], one["assets"]["dsm_2m"]
    one["assets"]["swir"] = one["assets"]["nir"]
    (catalogue.folder / "many.json").write_text(json.dumps(one))
    with pytest.raises(
        InputError, match=r"no asset is clearly the orthophoto; add #NAME to the address, one of: nir, swir"
    ):
        fetched(catalogue, "many.json", tmp_path)
    with pytest.raises(InputError, match=r"no asset is called red; add #NAME"):
        fetched(catalogue, "many.json#red", tmp_path)


@pytest.fixture
def api(catalogue: Web) -> Web:
    """An API whose search gives the old item on its first page and the new one on its second."""
    web, links = catalogue, [{"rel": "root", "href": catalogue.url()}]

    def absolute(name: str) -> dict[str, Any]:
        one = json.loads((web.folder / f"{name}.json").read_text())
        for asset in one["assets"].values():
            asset["href"] = web.url(asset["href"].removeprefix("./"))
        return {**one, "collection": "survey", "links": links}

    root = {
        **{"type": "Catalog", "stac_version": "1.0.0", "id": "api", "description": "for tests"},
        "conformsTo": [f"{API}/{part}" for part in ("core", "item-search", "collections", "ogcapi-features")],
        "links": [*links, {"rel": "search", "href": web.url("search"), "type": "application/geo+json"}],
    }
    about = collection("survey", [*links, {"rel": "items", "href": web.url("collections/survey/items")}])
    following = [{"rel": "next", "href": web.url("search?collections=survey&page=2")}]
    first = {"type": "FeatureCollection", "features": [absolute("old")], "links": following}
    second = {"type": "FeatureCollection", "features": [absolute("new")], "links": []}
    answers = {"page=2": second, "^/search": first, "^/collections/survey$": about, "^/$": root}
    web.behave(answers=[[pattern, json.dumps(text)] for pattern, text in answers.items()])
    return web


@pytest.mark.parametrize("path", ["collections/survey", "search?collections=survey"])
def test_an_api(api: Web, tmp_path: Path, path: str) -> None:
    found = fetched(api, path, tmp_path, bbox=box(left_m=380.0, side_m=60.0))
    assert found.facts.date == "2022-06-01" and "ortho.tif" not in api.sent
    searches = [one for one in api.seen if one.startswith("/search")]
    assert len(searches) >= 2 and (path != "collections/survey" or "bbox=" in searches[0])


def test_a_whole_api_is_too_much(api: Web, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a whole catalogue; give one of its collections"):
        fetch_reference("stac+" + api.url(), None, tmp_path, bbox=box())


@pytest.mark.parametrize(
    ("path", "content", "told"),
    [
        ("bad.json", "{oops", "cannot be read as a STAC item, collection or search"),
        ("list.json", "[1]", "cannot be read as a STAC item, collection or search"),
        ("other.json", '{"a": 1}', "is JSON, but no STAC item, collection or search"),
        ("none.json", None, "HTTP status 404: there is nothing"),
    ],
)
def test_what_is_no_stac(web: Web, tmp_path: Path, path: str, content: str | None, told: str) -> None:
    if content is not None:
        (web.folder / path).write_text(content)
    with pytest.raises(InputError, match=re.escape(told)) as error:
        fetched(web, f"{path}?token=SECRET", tmp_path / "out")
    assert "SECRET" not in str(error.value) and not (tmp_path / "out").exists()


def test_failures_name_the_address_that_failed(catalogue: Web, tmp_path: Path) -> None:
    catalogue.behave(refuse={"ortho.tif": 401})
    with pytest.raises(InputError, match=re.escape(f"{catalogue.url('ortho.tif')}: HTTP status 401")):
        fetched(catalogue, "old.json", tmp_path)
    catalogue.behave(refuse={"old.json": 403})
    with pytest.raises(InputError, match=re.escape(f"{catalogue.url('old.json')}: HTTP status 403")):
        fetched(catalogue, "old.json", tmp_path)
    catalogue.behave(stall_s=1.5)
    with pytest.raises(InputError, match="no answer within 1 s"):
        fetched(catalogue, "old.json", tmp_path)


def test_a_collection_needs_a_box(catalogue: Web, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds many items; say which part is needed: --bbox"):
        fetched(catalogue, "collection.json", tmp_path, bbox=None)
    with pytest.raises(InputError, match="has no item in the bounding box; check both"):
        fetched(catalogue, "collection.json", tmp_path, bbox=(1.0, 2.0, 3.0, 4.0))
