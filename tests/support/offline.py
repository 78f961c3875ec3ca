# SPDX-License-Identifier: Apache-2.0
"""Work that must not touch the network: whatever tries to, from Python or through GDAL, is an error."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rasterio

from skymoor.sources.addresses import reads_network


class TouchedNetwork(OSError):
    """The work tried to open a connection; libraries close what they opened on errors of this kind."""


@contextmanager
def offline() -> Iterator[None]:
    """Let nothing connect within the block, and raise at its end if something tried and went on.

    Sockets between processes of this machine have no address of a network.
    """
    tried: list[str] = []
    connect, opened = socket.socket.connect, rasterio.open

    def refuse(self: socket.socket, address: Any) -> None:
        if self.family != getattr(socket, "AF_UNIX", None):
            tried.append(f"a connection to {address}")
            raise TouchedNetwork(tried[-1])
        connect(self, address)

    def local(name: Any, *arguments: Any, **options: Any) -> Any:
        if isinstance(name, str) and reads_network(name):
            tried.append(f"GDAL would read {name}")
            raise TouchedNetwork(tried[-1])
        return opened(name, *arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", refuse)
        patch.setattr(socket.socket, "connect_ex", refuse)
        patch.setattr(rasterio, "open", local)
        # What else asks through libcurl finds a proxy that is not there.
        for name in ("http_proxy", "https_proxy", "GDAL_HTTP_PROXY"):
            patch.setenv(name, "http://127.0.0.1:9")
        yield
    if tried:
        raise TouchedNetwork(", ".join(tried))
