# SPDX-License-Identifier: Apache-2.0
"""Tile services on this machine: each tile is asked for once, and is where it belongs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from skymoor.errors import InputError
from skymoor.sources.fetch import fetch_reference
from support.web import Web
from support.web_rasters import box, wmts

TEMPLATE = "t/{z}/{x}/{y}.png?key=SECRET"


def require_right_tiles(path: Path, level: int) -> None:
    """Red and green of each pixel are the column and row of its tile."""
    with rasterio.open(path) as got:
        assert got.crs.to_epsg() == 3857
        values, t = got.read(), got.transform
    rows, columns = np.indices(values.shape[1:]) + 0.5
    side = 2 * 20037508.342789244 / 2**level
    assert t.a == pytest.approx(side / 256)
    x, y = t.c + t.a * columns, t.f + t.e * rows
    assert np.array_equal(values[0], np.floor((x + 20037508.342789244) / side) % 256)
    assert np.array_equal(values[1], np.floor((20037508.342789244 - y) / side) % 256)


def test_tiles_of_the_level_that_is_fine_enough(web: Web, tmp_path: Path) -> None:
    web.behave(tiles=True)
    found = fetch_reference(web.url(TEMPLATE), None, tmp_path, bbox=box())
    require_right_tiles(found.ortho, 18)
    assert len(web.seen) == len(set(web.seen)) > 1 and all("key=SECRET" in one for one in web.seen)
    assert all(b"SECRET" not in path.read_bytes() for path in tmp_path.iterdir())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ortho.tif", "reference.toml"]


def test_a_coarser_level(web: Web, tmp_path: Path) -> None:
    web.behave(tiles=True)
    require_right_tiles(fetch_reference(web.url(TEMPLATE), None, tmp_path, bbox=box(), pixel_m=2.0).ortho, 16)


def test_rows_from_the_south(web: Web, tmp_path: Path) -> None:
    web.behave(tiles=True)
    fetch_reference(web.url(TEMPLATE), None, tmp_path, bbox=box())
    north = {int(path.split("/")[4].split(".")[0]) for path in web.seen}
    web.forget()
    web.behave(tiles=True)
    fetch_reference(web.url(TEMPLATE.replace("{y}", "{-y}")), None, tmp_path, bbox=box())
    assert {2**18 - 1 - int(path.split("/")[4].split(".")[0]) for path in web.seen} == north


def test_wmts(web: Web, tmp_path: Path) -> None:
    web.behave(tiles=True)
    (web.folder / "capabilities.xml").write_text(wmts(web.url().rstrip("/")))
    found = fetch_reference("WMTS:" + web.url("capabilities.xml"), None, tmp_path / "a", bbox=box())
    require_right_tiles(found.ortho, 18)
    coarse = "WMTS:" + web.url("capabilities.xml,layer=photo")
    require_right_tiles(fetch_reference(coarse, None, tmp_path / "b", bbox=box(), pixel_m=1.0).ortho, 17)
    assert not Path("gdalwmscache").exists()
    with pytest.raises(InputError, match="HTTP status 404"):
        fetch_reference("WMTS:" + web.url("none.xml"), None, tmp_path / "c", bbox=box())


def test_a_level_that_is_not_there(web: Web, tmp_path: Path) -> None:
    web.behave(tiles=True)
    with pytest.raises(InputError, match=r"holds no valid pixel .* give a coarser --pixel"):
        fetch_reference(web.url(TEMPLATE), None, tmp_path / "out", bbox=box(), pixel_m=0.2)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"refuse": {"": 403}}, "HTTP status 403: access is denied"),
        ({"refuse": {"": 500}}, "HTTP status 500: the server failed"),
        ({"answers": [["^/t/", "<html>Sign in</html>"]]}, "broke off"),
        ({"tiles": True, "stall_s": 1.5}, "no answer within 1 s"),
    ],
)
def test_failures(web: Web, tmp_path: Path, changes: dict[str, object], told: str) -> None:
    web.behave(**changes)
    with pytest.raises(InputError, match=told) as error:
        fetch_reference(web.url(TEMPLATE), None, tmp_path / "out", bbox=box())
    assert "SECRET" not in str(error.value) and not (tmp_path / "out").exists()


def test_what_tiles_cannot_be(web: Web, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="covers the world; say which part"):
        fetch_reference(web.url(TEMPLATE), None, tmp_path)
    with pytest.raises(InputError, match="tiles are images and hold no heights"):
        fetch_reference(web.url("ortho.tif"), web.url(TEMPLATE), tmp_path, bbox=box())
