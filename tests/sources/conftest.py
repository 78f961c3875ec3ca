# SPDX-License-Identifier: Apache-2.0
"""A server with an orthophoto and its DSM."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from skymoor.sources import remote, stac, tiles
from support.web import Web, serving
from support.web_rasters import write_dsm, write_ortho


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Web]:
    """Of one module: ortho.tif, east.tif beside it, and dsm.tif."""
    folder = tmp_path_factory.mktemp("web")
    write_ortho(folder / "ortho.tif")
    write_ortho(folder / "east.tif", left_m=500.0, seed=9)
    write_dsm(folder / "dsm.tif")
    with serving(folder, tmp_path_factory.mktemp("aside")) as web:
        yield web


@pytest.fixture
def web(server: Web, monkeypatch: pytest.MonkeyPatch) -> Web:
    """The same, well behaved; whoever asks it waits for a second only."""
    server.forget()
    monkeypatch.setattr(remote, "RETRIES", 0)
    for module in (remote, stac, tiles):
        monkeypatch.setattr(module, "TIMEOUT_S", 1)
    return server
