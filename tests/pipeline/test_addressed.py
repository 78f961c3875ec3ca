# SPDX-License-Identifier: Apache-2.0
"""References by address in a site: fetched once into the folder of the run; a run on files opens no connection."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import rasterio

from skymoor.cli.main import main
from skymoor.errors import InputError
from skymoor.pipeline.addressed import with_files
from skymoor.pipeline.prior import SearchPrior
from skymoor.pipeline.site import Site, load_site, site_from_arguments
from skymoor.results.request import credits_of
from skymoor.sources.fetch import fetch_reference
from skymoor.types import no_progress
from support.offline import TouchedNetwork, offline
from support.small_run import summary_of
from support.web import Web, serving
from support.web_rasters import box, write_dsm, write_ortho


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Web]:
    folder = tmp_path_factory.mktemp("web")
    write_ortho(folder / "ortho.tif")
    write_dsm(folder / "dsm.tif")
    with serving(folder, tmp_path_factory.mktemp("aside")) as web:
        yield web


@pytest.fixture
def web(server: Web) -> Web:
    server.forget()
    return server


def site_of(web: Web, folder: Path, **changes: str) -> Site:
    (folder / "photos").mkdir(parents=True, exist_ok=True)
    lines = {
        "ortho": f'"{web.url("ortho.tif?key=SECRET")}"',
        "dsm": f'"{web.url("dsm.tif")}"',
        "licence": '"CC0-1.0"',
        "ce90": "2.0",
        "le90": "3.0",
        **changes,
    }
    reference = "\n".join(f"{key} = {value}" for key, value in lines.items())
    text = f'[reference]\n{reference}\n[airborne]\nimages = "photos"\n[prior]\narea = {list(box())}\n'
    (folder / "site.toml").write_text(text)
    return load_site(folder / "site.toml")


def silent(name: str) -> Any:
    return no_progress


def test_a_site_by_address_becomes_files_of_the_run(web: Web, tmp_path: Path) -> None:
    site = site_of(web, tmp_path)
    assert site.addressed is not None and not web.seen
    notes: list[str] = []
    local = with_files(site, tmp_path / "run", silent, notes.append)
    assert local.reference.ortho == tmp_path / "run" / "fetched" / "ortho.tif"
    assert isinstance(local.reference.dsm, Path) and local.reference.dsm.is_file()
    # The DSM's own CRS states it, and the area bounds what is read.
    assert local.reference.vertical_datum == "EPSG:3855"
    with rasterio.open(local.reference.ortho) as ortho:
        assert ortho.width < 220
    assert credits_of(local) == {
        "licence": "CC0-1.0",
        "credit": None,
        "date": None,
        "ortho_source": web.url("ortho.tif"),
        "dsm_source": web.url("dsm.tif"),
    }
    assert all(b"SECRET" not in path.read_bytes() for path in (tmp_path / "run" / "fetched").iterdir())


def test_the_same_request_is_not_fetched_again(web: Web, tmp_path: Path) -> None:
    site, run = site_of(web, tmp_path), tmp_path / "run"
    first = with_files(site, run, silent, lambda note: None).reference
    web.forget()
    notes: list[str] = []
    with offline():
        again = with_files(site, run, silent, notes.append).reference
        part = box(220.0, 220.0, 50.0)  # of what is there
        with_files(site.bounded(SearchPrior(area=part)), run, silent, notes.append)
    assert not web.seen and "is used; delete it to fetch it again" in notes[0]
    assert (again.ortho, again.vertical_datum) == (first.ortho, first.vertical_datum)
    with_files(site.bounded(SearchPrior(area=box(100.0))), run, silent, notes.append)
    assert "ortho.tif" in web.sent


def test_a_failure_leaves_no_reference_of_another_request(web: Web, tmp_path: Path) -> None:
    site, run = site_of(web, tmp_path), tmp_path / "run"
    with_files(site, run, silent, lambda note: None)
    web.behave(refuse={"dsm.tif": 404})
    with pytest.raises(InputError, match="404"):
        with_files(site.bounded(SearchPrior(area=box(100.0))), run, silent, lambda note: None)
    with pytest.raises(InputError, match="404"):
        with_files(site, run, silent, lambda note: None)


def test_one_height_and_an_address(web: Web, tmp_path: Path) -> None:
    local = with_files(site_of(web, tmp_path, dsm="12.5"), tmp_path / "run", silent, lambda note: None)
    assert local.reference.dsm == 12.5 and "dsm.tif" not in web.sent


def test_addresses_on_the_command_line(web: Web, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    write_dsm(tmp_path / "mine.tif")
    site = site_from_arguments([tmp_path / "photos"], [], web.url("ortho.tif"), tmp_path / "mine.tif", None, 2.0, 3.0)
    bounded = site.bounded(SearchPrior(area=box()))
    local = with_files(bounded, tmp_path / "run", silent, lambda note: None)
    assert local.reference.dsm == tmp_path / "run" / "fetched" / "dsm.tif"
    assert local.reference.vertical_datum == "EPSG:3855"


def test_paths_have_no_address(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    write_ortho(tmp_path / "ortho.tif", side=64)
    site = site_from_arguments([tmp_path / "photos"], [], tmp_path / "ortho.tif", None, None, 2.0, None)
    assert site.addressed is None and with_files(site, tmp_path / "run", silent, lambda note: None) is site


def test_the_command(web: Web, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sides = [str(side) for side in box()]
    sources = ["--ortho", web.url("ortho.tif?key=SECRET"), "--dsm", web.url("dsm.tif"), "--out", str(tmp_path / "out")]
    assert main(["reference", "--bbox", *sides, *sources, "--quiet"]) == 0
    told = capsys.readouterr().out
    assert "206 by 205 pixels of 0.5 m" in told and "licence and credit: the source does not say" in told
    assert "SECRET" not in told
    sources[1] = web.url("none.tif?key=SECRET")
    sources[-1] = str(tmp_path / "other")
    assert main(["reference", "--bbox", *sides, *sources]) == 2
    error = capsys.readouterr().err
    assert error == f"skymoor: {web.url('none.tif')}: HTTP status 404: there is nothing at this address; check it\n"
    assert not (tmp_path / "other").exists()


def test_offline_notices(web: Web, tmp_path: Path) -> None:
    # What is caught on the way counts as well.
    with pytest.raises(TouchedNetwork), offline(), suppress(InputError):
        fetch_reference(web.url("ortho.tif"), None, tmp_path / "raster")
    with pytest.raises(TouchedNetwork), offline(), suppress(InputError):
        fetch_reference(web.url("ortho.json"), None, tmp_path / "stac", bbox=box())
    assert not web.seen


@pytest.mark.e2e
def test_a_run_on_files_opens_no_connection(finished: Path) -> None:
    # The fixture runs it within `offline`.
    summary = summary_of(finished)
    assert summary["sets"][0]["status"] == "REGISTERED"
    assert json.dumps(summary["reference"]).count("source") == 2 and summary["reference"]["ortho_source"] is None
