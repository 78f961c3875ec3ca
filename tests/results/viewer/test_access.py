# SPDX-License-Identifier: Apache-2.0
"""The viewer answers its own address alone: not other machines, other web pages, or programs without its token."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from skymoor.errors import BackendUnavailable
from skymoor.results.read import Result
from skymoor.results.viewer import Page
from skymoor.results.viewer.access import only_with
from support.finished import finished_run

pytest.importorskip("viser", reason="viser is not installed: pip install skymoor[view]")
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

VERSION = Subprotocol(f"viser-v{viser.__version__}")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    page = Page(Result.read(finished_run(tmp_path_factory.mktemp("viewed"))), port)
    try:
        yield page.address
    finally:
        page.stop()


def status(address: str, path: str | None = None, **headers: str) -> int:
    parts = urlsplit(address)
    connection = HTTPConnection(parts.hostname or "", parts.port, timeout=20)
    connection.request("GET", parts.path if path is None else path, headers=headers)
    found = connection.getresponse().status
    connection.close()
    return found


def test_it_needs_its_token(address: str) -> None:
    token = urlsplit(address).path.strip("/")
    assert len(token) >= 20
    assert [status(address, path) for path in (None, f"/{token}", f"/{token}/?a=1")] == [200] * 3
    for path in ("/", "/index.html", f"/{token[:-1]}/", f"/{token}x", f"/x/{token}/", f"/%2e/{token}/"):
        assert status(address, path) == 403, path


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:{port}", "192.168.0.7:{port}", "[", ""])
def test_it_has_the_names_of_this_machine_alone(address: str, host: str) -> None:
    port = urlsplit(address).port
    assert status(address, Host=host.format(port=port)) == 403
    assert status(address, Host=f"localhost:{port}") == 200
    assert status(address, Host="localhost:9000") == 200  # a port that is forwarded


def opens(address: str, origin: str | None) -> bool:
    try:
        with connect(address.replace("http", "ws", 1), subprotocols=[VERSION], origin=origin) as socket:  # type: ignore[arg-type]
            return bool(socket.recv(timeout=20))
    except InvalidStatus as error:
        assert error.response.status_code == 403
        return False


def test_no_other_page_opens_its_web_socket(address: str) -> None:
    here = f"http://{urlsplit(address).netloc}"
    assert opens(address, here) and opens(address, None)
    assert not opens(f"{here}/", here) and not opens(f"{here}/", None)
    for origin in (
        "http://evil.example",
        "null",
        here.replace("http", "https") + ".evil.example",
        "http://127.0.0.1:1",
    ):
        assert not opens(address, origin), origin


def test_other_machines_do_not_reach_it(address: str) -> None:
    with socket.socket() as other:
        other.settimeout(5)
        # All of 127.0.0.0/8 is this machine: who listens on every address would answer here too.
        assert other.connect_ex(("127.0.0.2", urlsplit(address).port or 0)) != 0


def test_a_server_that_is_not_guarded_does_not_stay(tmp_path: Path) -> None:
    with pytest.raises(BackendUnavailable, match="viser"), only_with("token"):
        pass
