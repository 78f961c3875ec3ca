# SPDX-License-Identifier: Apache-2.0
"""A STAC item, read back and validated by pystac with the core schemas that it brings."""

from __future__ import annotations

import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pystac
import pytest
import rasterio
from shapely.geometry import Point, shape

from skymoor.results.export import export
from skymoor.results.read import Result
from support.exported_run import FRAME, cameras, write_run

FINISHED = datetime(2026, 5, 4, 10, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def item(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pystac.Item]:
    root = tmp_path_factory.mktemp("stac")
    run = write_run(root)
    os.utime(run / "summary.json", (FINISHED.timestamp(), FINISHED.timestamp()))
    export(Result.read(run), ["stac"], root / "out", lambda _: None)
    return run, pystac.Item.from_file(str(root / "out" / "stac" / "item.json"))


def test_the_item_is_valid(item: tuple[Path, pystac.Item]) -> None:
    core = item[1].full_copy()
    core.stac_extensions = []  # their schemas are on the network
    assert any(uri.endswith("item.json") for uri in core.validate())
    assert item[1].datetime == FINISHED
    assert all("/v" in uri for uri in item[1].stac_extensions) and len(item[1].stac_extensions) == 2


def test_the_outline_is_that_of_the_surface(item: tuple[Path, pystac.Item]) -> None:
    outline = shape(item[1].geometry)
    assert outline.is_valid and outline.exterior.is_ccw
    west, south, east, north = item[1].bbox
    np.testing.assert_allclose(outline.bounds, (west, south, east, north), atol=1e-7)
    corners = FRAME.enu_from_lla([south, north], [west, east], [FRAME.height_m] * 2)
    # The surface is 60 m wide and 57.5 m long; five rows in the north are not known.
    np.testing.assert_allclose(corners[1] - corners[0], [60, 57.5, 0], atol=1.5)
    lat, lon, _ = FRAME.lla_from_enu(np.zeros((1, 3)))[0]
    assert outline.contains(Point(lon, lat))


def test_assets_are_the_files_of_the_run(item: tuple[Path, pystac.Item]) -> None:
    run, found = item
    assert {"ortho", "dsm", "confidence", "pointcloud", "summary"} == set(found.assets)
    for asset in found.assets.values():
        path = Path(str(asset.get_absolute_href()))
        assert path.resolve().parent == run.resolve()
        data = path.read_bytes()
        assert asset.extra_fields["file:size"] == len(data)
        assert asset.extra_fields["file:checksum"] == "1220" + hashlib.sha256(data).hexdigest()
    fields = found.assets["dsm"].extra_fields
    with rasterio.open(run / "dsm.tif") as dsm:
        assert fields["proj:code"] == "EPSG:32719" and fields["proj:shape"] == list(dsm.shape)
        assert rasterio.Affine(*fields["proj:transform"]) == dsm.transform


def test_what_was_registered_is_stated(item: tuple[Path, pystac.Item]) -> None:
    (component,) = item[1].properties["skymoor:components"]
    assert (component["name"], component["status"], component["cameras"]) == ("airborne_0", "REGISTERED", 4)
    assert len(cameras()) == 5
