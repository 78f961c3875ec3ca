# SPDX-License-Identifier: Apache-2.0
"""A server on this machine: files with range requests, a tile service, and everything that goes wrong on the web.

It is a process of its own: rasterio keeps the interpreter's lock in some calls that read, and a thread could not
answer.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


@dataclass
class Behaviour:
    """What the server does.

    Attributes:
        refuse: status of paths that are refused; "" stands for all.
        halve: paths of which only half of what is asked for comes, before the connection ends.
        stall_s: before each answer.
        answers: pairs of a pattern of the path with its query and a text, for what is no file; the first counts.
        tiles: whether /t/z/x/y.png are tiles.
    """

    refuse: dict[str, int] = field(default_factory=dict)
    halve: list[str] = field(default_factory=list)
    stall_s: float = 0.0
    answers: list[list[str]] = field(default_factory=list)
    tiles: bool = False


@dataclass(frozen=True)
class Web:
    """A folder that is served; `control` and `log` are files by which the two processes talk."""

    folder: Path
    port: int
    control: Path
    log: Path

    def url(self, path: str = "") -> str:
        """An address such as http://127.0.0.1:PORT/ortho.tif."""
        return f"http://127.0.0.1:{self.port}/{path}"

    def behave(self, **changes: Any) -> None:
        """Behave like this from now on, and well where nothing is said."""
        fresh = self.control.with_suffix(".new")
        fresh.write_text(json.dumps(asdict(Behaviour(**changes))))
        fresh.replace(self.control)

    def forget(self) -> None:
        """Begin a new log, and behave well."""
        self.log.write_text("")
        self.behave()

    @property
    def seen(self) -> list[str]:
        """Paths with their queries, of all requests."""
        return [json.loads(line)[0] for line in self.log.read_text().splitlines()]

    @property
    def sent(self) -> dict[str, int]:
        """Bytes of all bodies, by path."""
        total: dict[str, int] = {}
        for line in self.log.read_text().splitlines():
            path, size = json.loads(line)
            name = path.partition("?")[0].lstrip("/")
            total[name] = total.get(name, 0) + size
        return total


@contextmanager
def serving(folder: Path, aside: Path) -> Iterator[Web]:
    """Serve a folder until the block ends; `aside` is a folder for what the two processes write."""
    control, log = aside / "control.json", aside / "log.txt"
    log.write_text("")
    control.write_text(json.dumps(asdict(Behaviour())))
    command = [sys.executable, "-m", "support.web", str(folder), str(control), str(log)]
    tests = str(Path(__file__).parents[1])
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": tests})
    assert server.stdout is not None
    try:
        yield Web(folder, int(server.stdout.readline()), control, log)
    finally:
        server.terminate()
        server.wait()
        server.stdout.close()


class Handler(BaseHTTPRequestHandler):
    """Answers from `folder` as `control` says."""

    protocol_version = "HTTP/1.1"
    folder, control, log = Path(), Path(), Path()

    def do_GET(self) -> None:
        with suppress(ConnectionError):  # whoever asked has had enough
            self._serve(body=True)

    def do_HEAD(self) -> None:
        with suppress(ConnectionError):
            self._serve(body=False)

    def log_message(self, format: str, *args: object) -> None:
        """Not on the screen."""

    def _serve(self, *, body: bool) -> None:
        told = Behaviour(**json.loads(self.control.read_text()))
        path = self.path.partition("?")[0].lstrip("/")
        time.sleep(told.stall_s)
        content = self._content(path, told)
        status = told.refuse.get(path) or told.refuse.get("") or (404 if content is None else 200)
        content = b"<html>no</html>" if content is None or status >= 400 else content
        status, content, span = self._range(status, content)
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Accept-Ranges", "bytes")
        if span:
            self.send_header("Content-Range", span)
        self.end_headers()
        if path in told.halve:
            content = content[: len(content) // 2]
            self.close_connection = True
        with self.log.open("a") as log:
            log.write(json.dumps([self.path, len(content) if body else 0]) + "\n")
        if body:
            self.wfile.write(content)

    def _range(self, status: int, content: bytes) -> tuple[int, bytes, str]:
        asked = self.headers.get("Range")
        if not asked or status != 200:
            return status, content, ""
        first, _, last = asked.removeprefix("bytes=").partition("-")
        start, end = int(first), min(int(last or len(content) - 1), len(content) - 1)
        if start >= len(content):
            return 416, b"", f"bytes */{len(content)}"
        return 206, content[start : end + 1], f"bytes {start}-{end}/{len(content)}"

    def _content(self, path: str, told: Behaviour) -> bytes | None:
        file = self.folder / path
        if path and file.is_file():
            return file.read_bytes()
        answer = next((text for pattern, text in told.answers if re.search(pattern, self.path)), None)
        if answer is not None:
            return answer.encode()
        if told.tiles:
            from support.web_rasters import tile

            return tile(path)
        return None


if __name__ == "__main__":
    Handler.folder, Handler.control, Handler.log = (Path(word) for word in sys.argv[1:])
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        sys.stdout.write(f"{http.server_address[1]}\n")
        sys.stdout.flush()
        http.serve_forever()
