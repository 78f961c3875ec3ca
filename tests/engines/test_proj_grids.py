# SPDX-License-Identifier: Apache-2.0
"""PROJ's grids from a server on this machine: fetched whole and checked, and then found; nothing else downloads."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from skymoor.engines.proj_grids import COMMON, fetch_grid, grids_of
from skymoor.errors import InputError
from support.geoid import write_constant_geoid

EGM = "us_nga_egm08_25.tif"


class Quiet(SimpleHTTPRequestHandler):
    """Serves a folder."""

    def log_message(self, format: str, *args: object) -> None:
        """Not on the screen."""


@dataclass(frozen=True)
class Server:
    """PROJ's server: its folder and its address; and the folder of a user, as environment of a process."""

    folder: Path
    url: str
    user: Path

    @property
    def environment(self) -> dict[str, str]:
        return {**os.environ, "PROJ_NETWORK_ENDPOINT": self.url, "PROJ_USER_WRITABLE_DIRECTORY": str(self.user)}

    def skymoor(self, *arguments: str) -> tuple[int, str, str]:
        """In another process, since PROJ reads its environment once."""
        command = [sys.executable, "-c", MAIN, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, env=self.environment)
        return done.returncode, done.stdout, done.stderr

    def list(self, **changes: object) -> None:
        """Write the catalogue; `changes` are to what it says of the grid."""
        content = (self.folder / EGM).read_bytes()
        facts = {"name": EGM, "source_id": "us_nga", "url": f"https://cdn.proj.org/{EGM}", "file_size": len(content)}
        facts["sha256sum"] = hashlib.sha256(content).hexdigest()
        other = {**facts, "name": f"other_{EGM}", "sha256sum": "0" * 64}
        features = [{"type": "Feature", "properties": one, "geometry": None} for one in (other, {**facts, **changes})]
        (self.folder / "files.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))


MAIN = "import sys; from skymoor.cli.main import main; sys.exit(main(sys.argv[1:]))"
HEIGHT = """
from skymoor.errors import InputError
from skymoor.geo import ellipsoidal_heights
try:
    print(ellipsoidal_heights(47.0, 8.3, 400.0, "EPSG:3855")[0])
except InputError as error:
    print(error)
"""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    folder = tmp_path / "cdn"
    folder.mkdir()
    write_constant_geoid(folder / EGM, 47.5)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as http:
        threading.Thread(target=http.serve_forever, daemon=True).start()
        made = Server(folder, f"http://127.0.0.1:{http.server_address[1]}", tmp_path / "user" / "proj")
        made.list()
        yield made
        http.shutdown()


def silent(name: str) -> Callable[[int, int], object]:
    return lambda done, total: None


def ellipsoidal(server: Server) -> str:
    done = subprocess.run(
        [sys.executable, "-c", HEIGHT], capture_output=True, text=True, check=True, env=server.environment
    )
    return done.stdout.strip()


def test_what_the_error_tells_to_do_is_enough(server: Server) -> None:
    assert f"run `skymoor grids fetch {EGM}`" in ellipsoidal(server)
    status, out, _ = server.skymoor("grids", "fetch", EGM)
    assert status == 0 and f"{server.user / EGM}: fetched, sha256 " in out
    assert float(ellipsoidal(server)) == pytest.approx(447.5)
    status, out, _ = server.skymoor("grids", "list", "--json")
    assert status == 0 and json.loads(out)["datums"][0]["here"] == [EGM]


@pytest.fixture
def here(server: Server, monkeypatch: pytest.MonkeyPatch) -> Server:
    """The same server and user in this process."""
    monkeypatch.setattr("skymoor.engines.proj_grids.get_proj_endpoint", lambda: server.url)
    for module in ("skymoor.engines.proj_grids", "skymoor.geo.operations"):
        monkeypatch.setattr(f"{module}.get_user_data_dir", lambda: str(server.user))
    return server


@pytest.mark.parametrize("wanted", ["EPSG:3855", EGM, EGM.removesuffix(".tif")])
def test_fetched_once_by_file_or_datum(wanted: str, here: Server) -> None:
    steps: list[tuple[str, int, int]] = []
    fetched = fetch_grid(wanted, lambda name: lambda done, total: steps.append((name, done, total)))
    content = (here.folder / EGM).read_bytes()
    assert fetched.path == here.user / EGM and fetched.path.read_bytes() == content and not fetched.was_there
    assert fetched.sha256 == hashlib.sha256(content).hexdigest() and steps[-1] == (EGM, 1, 1)
    assert [path.name for path in here.user.iterdir()] == [EGM]
    (here.folder / "files.geojson").unlink()  # it is not asked again
    assert fetch_grid(wanted, silent).was_there


def refused(wanted: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        fetch_grid(wanted, silent)
    assert "\n" not in str(caught.value)


def test_another_file_than_the_catalogue_says_is_not_kept(here: Server) -> None:
    here.list(sha256sum="1" * 64)
    refused(EGM, "not the file that skymoor knows")
    assert not list(here.user.iterdir())


def test_names_that_do_not_exist(here: Server) -> None:
    refused("08_25.tif", r"08_25\.tif: PROJ's catalogue has no grid of this name")  # part of a name
    assert not list(here.user.iterdir())


@pytest.mark.parametrize("catalogue", ["<html>captive portal</html>", "[]", '{"features": [{}]}'])
def test_something_else_than_the_catalogue(catalogue: str, here: Server) -> None:
    (here.folder / "files.geojson").write_text(catalogue)
    refused(EGM, "catalogue")


def test_no_network_is_one_line(server: Server) -> None:
    (server.folder / "files.geojson").unlink()
    status, _, error = server.skymoor("grids", "fetch", EGM)
    assert status == 2 and len(error.splitlines()) == 1
    assert "cannot be fetched" in error and f"put the file into {server.user} by hand" in error


def test_datums_without_or_with_several_grids() -> None:
    for datum, message in (
        ("EPSG:32632", "needs no grid"),
        ("EPSG:5703", r"several grids, fetch that of your site .*us_noaa_g2018u0\.tif \(United States"),
        ("EPSG:999999", "neither a grid nor a datum"),
    ):
        refused(datum, message)


def test_every_common_datum_has_a_grid() -> None:
    assert all(grids_of(code).grids for code in COMMON)
    assert grids_of("EPSG:9518").grids == grids_of("EPSG:3855").grids  # compound: with EGM2008
    assert [name for name, _ in grids_of("EPSG:27700").grids] == ["uk_os_OSTN15_NTv2_OSGBtoETRS.tif"]
