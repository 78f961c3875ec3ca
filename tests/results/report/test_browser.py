# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser, at the width of a phone and of a desk."""

from __future__ import annotations

from pathlib import Path

import pytest

from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from support.browser import complaints, found_by, needs_chromium, opened, served
from support.finished import finished_run

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


@needs_chromium
@pytest.mark.parametrize("width", [390, 1280])
def test_it_works_without_errors_and_requests(tmp_path: Path, width: int) -> None:
    page = report_page(Result.read(finished_run(tmp_path)))
    with served({"/report.html": page, "/": HARNESS.replace("WIDTH", str(width))}) as (address, asked):
        done = opened(address, tmp_path)
    found = found_by(done)
    assert sorted(asked) == ["/", "/report.html"]
    assert not complaints(done)
    assert found["overflow"] <= 0
    assert found["visible"] == ["verdict", "chart", "slider", "components", "stages"]
    assert found["pictures"] == 0
    assert (found["swipe"], found["zoomed"]) == ("30%", True)
    assert found["tip"].startswith("air/<b>ä & 駅.jpg")
