# SPDX-License-Identifier: Apache-2.0
"""Pages in a headless Chromium, where there is one."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-extensions"),
)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium on this machine; install it or name one in CHROMIUM"
)


@contextmanager
def served(pages: dict[str, str]) -> Iterator[tuple[str, list[str]]]:
    """Pages by their path, and the paths that were asked for."""
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(200 if self.path in pages else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(pages.get(self.path, "").encode())

        def log_message(self, format: str, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}", asked
        finally:
            server.shutdown()


def opened(address: str, folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """What Chromium makes of a page: its document on stdout, messages of scripts on stderr."""
    assert CHROMIUM is not None
    command = [CHROMIUM, *QUIET, f"--user-data-dir={folder / 'profile'}", "--window-size=1400,1000", *more]
    command += ["--enable-logging=stderr", "--virtual-time-budget=4000", "--dump-dom", address]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def complaints(done: subprocess.CompletedProcess[str]) -> Sequence[str]:
    """What the page's scripts and its policy complained about."""
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def found_by(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """The JSON that a page wrote into its element `found`."""
    text = re.search(r'<pre id="found">(.*?)</pre>', done.stdout)
    assert text is not None and text[1], done.stderr[-2000:]
    found: dict[str, Any] = json.loads(text[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    return found


def outside(log: Path) -> set[str]:
    """Hosts other than this machine that pages asked for, by the log that --log-net-log=FILE makes."""
    started = [
        event["params"]
        for event in json.loads(log.read_text(encoding="utf-8"))["events"]
        if "url" in event.get("params", {}) and str(event["params"].get("initiator", "")).startswith("http")
    ]
    assert started  # or the log would prove nothing
    return {str(urlsplit(one["url"]).hostname) for one in started} - {"127.0.0.1"}
