# SPDX-License-Identifier: Apache-2.0
"""Who may see the viewer: who has its address, on this machine. viser answers every web page that knows the port."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from skymoor.errors import BackendUnavailable

NAMES = ("127.0.0.1", "localhost", "::1")


@contextmanager
def only_with(token: str) -> Iterator[None]:
    """A server of viser that starts within the block answers requests below /`token`/, under a name of this machine.

    Everything else is refused: a page of the web reaches this port too, by a name of its own that leads here or by a
    web socket, for which browsers do not ask whether it may. Raises `BackendUnavailable` where no server of the kind
    that is known has started: then nothing would be refused.
    """
    from websockets.asyncio import server

    real: Any = server.serve
    started: list[object] = []

    def serve(*arguments: Any, process_request: Any, **options: Any) -> Any:
        async def checked(connection: Any, request: Any) -> Any:
            if not _is_allowed(request.headers, request.path, token):
                return connection.respond(HTTPStatus.FORBIDDEN, "use the address that skymoor view printed\n")
            inner = replace(request, path=request.path[len(token) + 1 :] or "/")
            answer = process_request(connection, inner)
            return await answer if inspect.isawaitable(answer) else answer

        started.append(arguments)
        return real(*arguments, process_request=checked, **options)

    server.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = real  # type: ignore[misc]
    if not started:
        raise BackendUnavailable(
            "this version of viser serves its page in a way that is not known; pip install viser==1.1.1"
        )


def _is_allowed(headers: Any, path: str, token: str) -> bool:
    host, origin = headers.get("Host", ""), headers.get("Origin")
    if _name(f"//{host}") not in NAMES or (origin is not None and urlsplit(origin).netloc != host):
        return False
    return path.partition("?")[0].startswith(f"/{token}/") or path.partition("?")[0] == f"/{token}"


def _name(address: str) -> str | None:
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None
