# SPDX-License-Identifier: Apache-2.0
"""The page that asks in a real browser: by mouse, by keyboard, at the width of a phone and of a desk."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from skymoor.results.ask.page import AskPage
from skymoor.results.ask.question import questions_of
from skymoor.results.ask.server import GROUPS, AskServer
from skymoor.results.read import Result
from support.asked import refused_run
from support.browser import complaints, found_by, needs_chromium, opened, served

HARNESS = """<!doctype html><link rel="icon" href="data:,"><pre id="found"></pre><script>
const found = {}, frame = document.createElement("iframe");
frame.style = "width:WIDTHpx;height:900px;border:0";
frame.onload = () => {
  const page = frame.contentDocument, root = page.documentElement, form = page.querySelector("form");
  const value = (name) => Number(form.elements.namedItem(name).value);
  const pointer = (svg, kind, x, y) => {
    const box = svg.getBoundingClientRect(), view = svg.viewBox.baseVal;
    const scale = Math.min(box.width / view.width, box.height / view.height);
    svg.dispatchEvent(new frame.contentWindow.PointerEvent(kind, {bubbles: true, pointerId: 1,
      clientX: box.left + box.width / 2 + (x - 0.5) * view.width * scale,
      clientY: box.top + box.height / 2 + (y - 0.5) * view.height * scale}));
  };
  const choose = (mode) => {
    const one = form.querySelector(`[name="mode"][value="${mode}"]`);
    one.checked = true; one.dispatchEvent(new Event("input", {bubbles: true}));
  };
  const map = form.querySelector('[data-kind="map"]'), render = form.querySelector('[data-kind="render"]');
  found.overflow = root.scrollWidth - frame.contentWindow.innerWidth;
  found.pictures = [...page.images].filter((one) => !one.naturalWidth).length;
  pointer(map, "pointerdown", 0.5, 0.5); pointer(map, "pointerup", 0.6, 0.6);
  found.idle = form.elements.namedItem("area_west").value;
  choose("area");
  pointer(map, "pointerdown", 0.75, 0.25); pointer(map, "pointermove", 0.5, 0.5); pointer(map, "pointerup", 0.25, 0.75);
  found.area = ["area_west", "area_south", "area_east", "area_north"].map(value);
  const marked = () => map.querySelector(".mark").getBBox();
  found.marked = [marked().width / map.viewBox.baseVal.width, marked().height / map.viewBox.baseVal.height];
  choose("length");
  pointer(render, "pointerdown", 0.25, 0.5); pointer(render, "pointerup", 0.75, 0.5);
  found.length = ["length_u0", "length_v0", "length_u1", "length_v1"].map(value);
  choose("point");
  pointer(render, "pointerdown", 0.5, 0.25); pointer(render, "pointerup", 0.5, 0.25);
  pointer(map, "pointerdown", 0.5, 0.5); pointer(map, "pointerup", 0.5, 0.5);
  found.point = ["point_u", "point_v", "point_lat", "point_lon"].map(value);
  found.unnamed = [...form.querySelectorAll("input:not([type=hidden])")].filter((one) => !one.labels.length).length;
  const radio = form.querySelector('[name="candidate"][value="2"]');
  radio.focus(); found.focused = page.activeElement === radio; radio.click();
  found.chosen = new frame.contentWindow.FormData(form).get("candidate");
  document.getElementById("found").textContent = JSON.stringify(found);
};
frame.src = "/ask.html";
document.body.append(frame);
</script>"""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return Result.read(refused_run(tmp_path_factory.mktemp("asked")))


@needs_chromium
@pytest.mark.parametrize("width", [390, 1280])
def test_clicks_and_drags_fill_in_the_fields(width: int, result: Result, tmp_path: Path) -> None:
    page = AskPage(result, questions_of(result)).asking("try again").decode()
    with served({"/ask.html": page, "/": HARNESS.replace("WIDTH", str(width))}) as (address, asked):
        done = opened(address, tmp_path)
    found = found_by(done)
    assert sorted(asked) == ["/", "/ask.html"] and not complaints(done)
    assert found["overflow"] <= 0 and found["pictures"] == 0 and found["idle"] == ""
    extent = page.partition('data-extent="')[2].partition('"')[0]
    west, south, east, north = map(float, extent.split())
    quarters = [[west + share * (east - west), south + share * (north - south)] for share in (0.25, 0.75, 0.5)]
    lla = result.frame.lla_from_enu(np.column_stack([quarters, np.zeros(3)]))
    west_south_east_north = [lla[0, 1], lla[0, 0], lla[1, 1], lla[1, 0]]
    np.testing.assert_allclose(found["area"], west_south_east_north, atol=2e-6)
    np.testing.assert_allclose(found["marked"], [0.5, 0.5], atol=0.02)
    np.testing.assert_allclose(found["length"], [20, 40, 60, 40], atol=0.3)
    np.testing.assert_allclose(found["point"][:2], [40, 20], atol=0.3)
    np.testing.assert_allclose(found["point"][2:], lla[2, :2], atol=2e-6)
    assert (found["unnamed"], found["focused"], found["chosen"]) == (0, True, "2")


@needs_chromium
def test_its_own_policy_lets_the_page_work_and_nothing_else_load(result: Result, tmp_path: Path) -> None:
    with AskServer(result, questions_of(result)) as server:
        done = opened(server.address, tmp_path)
    assert not complaints(done)
    assert 'class="draw"' in done.stdout and "Place 2" in done.stdout


def test_the_fields_are_those_that_are_read(result: Result) -> None:
    page = AskPage(result, questions_of(result)).asking().decode()
    names = set(re.findall(r'<input[^>]*? name="(\w+)"', page))
    groups = {f"{name}_{part}" for name, parts in GROUPS.items() for part in parts}
    assert names == groups | {"component", "candidate", "mode", "north", "heading", "height", "by"}
    identities = re.findall(r' id="([^"]+)"', page)
    assert len(identities) == len(set(identities))
    assert set(re.findall(r' for="([^"]+)"', page)) <= set(identities)
    assert set(re.findall(r'labelledby="([^"]+)"', page)) <= set(identities)
