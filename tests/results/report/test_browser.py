# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser, at the width of a phone and of a desk."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from support.finished import finished_run

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-extensions"),
)
# A frame of the wanted width, because windows have a least one; what it finds is written where --dump-dom shows it.
HARNESS = """<!doctype html><link rel="icon" href="data:,"><pre id="found"></pre><script>
const found = {errors: []}, frame = document.createElement("iframe");
const put = (text) => { document.getElementById("found").textContent = text; };
frame.style = "width:WIDTHpx;height:900px;border:0";
frame.onload = () => {
  const page = frame.contentDocument, root = page.documentElement, slider = page.getElementById("slider");
  found.overflow = root.scrollWidth - frame.contentWindow.innerWidth;
  found.visible = ["verdict", "chart", "slider", "components", "stages"].filter(
    (id) => page.getElementById(id).getBoundingClientRect().height > 4);
  found.pictures = [...page.images].filter((one) => one.loading !== "lazy" && !one.naturalWidth).length;
  slider.value = "30"; slider.dispatchEvent(new Event("input"));
  found.swipe = page.querySelector(".pair").style.getPropertyValue("--x");
  const before = page.getElementById("chart").getAttribute("viewBox");
  page.querySelector("[data-zoom]").click();
  found.zoomed = before !== page.getElementById("chart").getAttribute("viewBox");
  page.querySelector(".dot").dispatchEvent(new PointerEvent("pointerover", {bubbles: true}));
  found.tip = page.getElementById("tip").textContent;
  put(JSON.stringify(found));
};
frame.src = "/report.html";
document.body.append(frame);
</script>"""


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


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine; install it or name one in CHROMIUM")
@pytest.mark.parametrize("width", [390, 1280])
def test_it_works_without_errors_and_requests(tmp_path: Path, width: int) -> None:
    assert CHROMIUM is not None
    page = report_page(Result.read(finished_run(tmp_path)))
    with served({"/report.html": page, "/": HARNESS.replace("WIDTH", str(width))}) as (address, asked):
        command = [CHROMIUM, *QUIET, f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1400,1000"]
        command += ["--enable-logging=stderr", "--virtual-time-budget=4000", "--dump-dom", address]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    text = re.search(r'<pre id="found">(.*?)</pre>', done.stdout)
    assert text is not None and text[1], done.stderr[-2000:]
    found = json.loads(text[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    assert sorted(asked) == ["/", "/report.html"]
    assert not [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert found["overflow"] <= 0
    assert found["visible"] == ["verdict", "chart", "slider", "components", "stages"]
    assert found["pictures"] == 0
    assert (found["swipe"], found["zoomed"]) == ("30%", True)
    assert found["tip"].startswith("air/<b>ä & 駅.jpg")
