# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: at the width of a phone and of a desk, printed, and as assistive technology finds it."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from skymoor.geo import EnuFrame
from skymoor.results.read import Result
from skymoor.results.report.maps import OPENSTREETMAP
from skymoor.results.report.page import report_page
from skymoor.results.report.pdf import print_report
from skymoor.results.report.words import NONE
from support.browser import complaints, found_by, needs_chromium, opened, outside, served
from support.finished import finished_run

# A frame of the wanted width, because windows have a least one; what it finds is written where --dump-dom shows it.
FRAME = """<!doctype html><link rel="icon" href="data:,"><pre id="found"></pre><script>
const found = {}, frame = document.createElement("iframe");
const put = () => { document.getElementById("found").textContent = JSON.stringify(found); };
frame.style = "width:WIDTHpx;height:900px;border:0";
frame.onload = () => {
  const page = frame.contentDocument, root = page.documentElement;
  found.overflow = root.scrollWidth - frame.contentWindow.innerWidth;
  CHECKS
};
frame.src = "/report.html";
document.body.append(frame);
</script>"""
WORKS = """
  const slider = page.getElementById("slider");
  found.visible = ["summary", "verdict", "chart", "slider", "components", "stages"].filter(
    (id) => page.getElementById(id).getBoundingClientRect().height > 4);
  found.pictures = [...page.images].filter((one) => one.loading !== "lazy" && !one.naturalWidth).length;
  found.covered = [...page.querySelectorAll("figure")].filter((one) => one.scrollHeight > one.clientHeight + 1).length;
  slider.value = "30"; slider.dispatchEvent(new Event("input"));
  found.swipe = page.querySelector(".pair").style.getPropertyValue("--x");
  const before = page.getElementById("chart").getAttribute("viewBox");
  page.querySelector("[data-zoom]").click();
  found.zoomed = before !== page.getElementById("chart").getAttribute("viewBox");
  page.querySelector(".dot").dispatchEvent(new PointerEvent("pointerover", {bubbles: true}));
  found.tip = page.getElementById("tip").textContent;
  put();
"""
SORTS = """
  const table = page.querySelector("table.sortable"), heads = [...table.tHead.rows[0].cells];
  const sorted = (k) => {
    const button = heads[k].querySelector("button");
    button.focus(); button.click();
    return [page.activeElement === button, heads.map((one) => one.ariaSort).filter((one) => one !== "none"),
            [...table.tBodies[0].rows].map((row) => row.cells[k].textContent)];
  };
  found.before = [...table.tBodies[0].rows].length;
  found.points = sorted(9); found.again = sorted(9); found.image = sorted(0);
  put();
"""
TILES = """
  found.first = page.querySelectorAll("#tiles image").length;
  page.getElementById("basemap").click();
  const shown = () => [...page.querySelectorAll("#tiles image")].map((one) =>
    [one.getAttribute("href"), ...one.getAttribute("transform").slice(7, -1).split(" ").map(Number)]);
  found.tiles = shown();
  found.box = page.getElementById("chart").getAttribute("viewBox").split(" ").map(Number);
  const credit = page.getElementById("credit");
  found.credit = credit.getBoundingClientRect().height > 4 && credit.textContent;
  page.querySelector("[data-zoom='0.7']").click(); page.querySelector("[data-zoom='0.7']").click();
  page.querySelector("[data-zoom='0.7']").click();
  found.finer = shown().map((one) => one[0]);
  setTimeout(() => { found.lost = !page.getElementById("lost").hidden; put(); }, 1500);
"""
HEARD = """
  const script = page.createElement("script");
  script.src = "/axe.js";
  script.onload = () => frame.contentWindow.axe.run(page, {resultTypes: ["violations"]}).then((result) => {
    found.violations = result.violations.map((one) => one.id + ": " + one.nodes.map((node) => node.target).join(" "));
    found.passed = result.passes.length;
    put();
  });
  page.head.append(script);
"""


def harness(width: int, checks: str) -> str:
    return FRAME.replace("WIDTH", str(width)).replace("CHECKS", checks)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return report_page(Result.read(finished_run(tmp_path_factory.mktemp("report"))))


@needs_chromium
@pytest.mark.parametrize("width", [375, 1280])
def test_it_works_without_errors_and_requests(page: str, tmp_path: Path, width: int) -> None:
    with served({"/report.html": page, "/": harness(width, WORKS)}) as (address, asked):
        done = opened(address, tmp_path)
    found = found_by(done)
    assert sorted(asked) == ["/", "/report.html"]
    assert not complaints(done)
    assert found["overflow"] <= 0 and found["covered"] == 0
    assert found["visible"] == ["summary", "verdict", "chart", "slider", "components", "stages"]
    assert found["pictures"] == 0
    assert (found["swipe"], found["zoomed"]) == ("30%", True)
    assert found["tip"].startswith("air/<b>ä & 駅.jpg")


def _numbers(cells: Sequence[str]) -> list[float]:
    return [float(cell) for cell in cells if cell != NONE]


@needs_chromium
def test_photos_are_sorted_by_click_or_key(page: str, tmp_path: Path) -> None:
    with served({"/report.html": page, "/": harness(375, SORTS)}) as (address, _):
        found = found_by(opened(address, tmp_path))
    (focused, state, cells), (_, state_again, cells_again) = found["points"], found["again"]
    assert focused and (state, state_again) == (["ascending"], ["descending"])
    assert len(cells) == found["before"] and len(_numbers(cells)) == 8
    assert _numbers(cells) == sorted(_numbers(cells)) and _numbers(cells_again) == sorted(_numbers(cells), reverse=True)
    assert cells[8:] == cells_again[8:] == [NONE] * 2  # what has no value comes last both ways
    assert found["image"][1] == ["ascending"] and found["image"][2][1:9] == [f"air/00{k}.jpg" for k in range(1, 9)]


@needs_chromium
@pytest.mark.skipif(importlib.util.find_spec("axe_core_python") is None, reason="axe-core-python is not installed")
@pytest.mark.parametrize(("width", "more"), [(375, ()), (1280, ("--force-dark-mode",))])
def test_axe_finds_nothing(page: str, tmp_path: Path, width: int, more: tuple[str, ...]) -> None:
    spec = importlib.util.find_spec("axe_core_python")
    assert spec is not None and spec.origin is not None
    axe = Path(spec.origin).with_name("axe.min.js").read_text(encoding="utf-8")
    with served({"/report.html": page, "/axe.js": axe, "/": harness(width, HEARD)}) as (address, _):
        found = found_by(opened(address, tmp_path, *more))
    assert found["passed"] > 20
    assert found["violations"] == []


@needs_chromium
def test_it_is_printed_on_a_few_pages(page: str, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    content = print_report(tmp_path).read_bytes()
    assert 5 <= content.count(b"/Type /Page\n") <= 20


@needs_chromium
@pytest.mark.parametrize("clicked", [False, True])
def test_a_background_map_is_asked_for_by_the_click_alone(page: str, tmp_path: Path, clicked: bool) -> None:
    log = tmp_path / "net.json"
    checks = TILES if clicked else WORKS
    with served({"/report.html": page, "/": harness(1280, checks)}) as (address, _):
        opened(address, tmp_path, f"--log-net-log={log}")
    assert outside(log) == ({"tile.openstreetmap.org"} if clicked else set())


def _tile_corner(x: float, y: float, z: int) -> tuple[float, float]:
    """Longitude and latitude of the north-western corner of a tile, by PROJ."""
    half = np.pi * 6378137.0
    metres = -half + 2 * half * x / 2**z, half - 2 * half * y / 2**z
    return Transformer.from_crs("EPSG:3857", "EPSG:4326", always_xy=True).transform(*metres)


@needs_chromium
def test_tiles_are_those_of_the_place_and_lie_there(page: str, tmp_path: Path) -> None:
    here = page.replace(OPENSTREETMAP.tiles, "/tiles/{z}/{x}/{y}.png")
    with served({"/report.html": here, "/": harness(1280, TILES)}) as (address, asked):
        found = found_by(opened(address, tmp_path))
    assert found["first"] == 0 and found["lost"] and "OpenStreetMap contributors" in found["credit"]
    assert {one[0] for one in found["tiles"]} <= set(asked)
    origin = re.search(r'data-lat="([^"]+)" data-lon="([^"]+)"', page)
    assert origin is not None
    frame = EnuFrame(float(origin[1]), float(origin[2]), 500.0)
    numbers = []
    for href, xx, xy, yx, yy, x0, y0 in found["tiles"]:
        z, x, y = map(int, href[len("/tiles/") : -len(".png")].split("/"))
        numbers.append((z, x, y))
        for (right, down), at in {(0, 0): (x0, y0), (1, 0): (x0 + xx, y0 + xy), (0, 1): (x0 + yx, y0 + yy)}.items():
            lon, lat = _tile_corner(x + right, y + down, z)
            enu = frame.enu_from_lla(lat, lon, 500.0)[0]
            np.testing.assert_allclose(at, [enu[0], -enu[1]], atol=0.02)
    west, top, width, height = found["box"]
    corners = frame.lla_from_enu([[west, -top, 0.0], [west + width, -top - height, 0.0]])
    (z,) = {one[0] for one in numbers}
    to_metres = Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)
    size = 2 * np.pi * 6378137.0 / 2**z
    (left, upper), (right, lower) = (to_metres.transform(lla[1], lla[0]) for lla in corners)
    columns = range(int((left + size * 2**z / 2) // size), int((right + size * 2**z / 2) // size) + 1)
    rows = range(int((size * 2**z / 2 - upper) // size), int((size * 2**z / 2 - lower) // size) + 1)
    assert set(numbers) == {(z, x, y) for x in columns for y in rows}
    assert {int(one.split("/")[2]) for one in found["finer"]} <= {z, z + 1, z + 2} and z <= OPENSTREETMAP.finest
