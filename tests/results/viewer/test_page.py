# SPDX-License-Identifier: Apache-2.0
"""The page of the viewer, served within this process."""

from __future__ import annotations

import json
import socket
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from skymoor.results.read import Result
from skymoor.results.viewer import Page
from skymoor.results.viewer.cameras import frustum_scale
from support.browser import needs_chromium, opened, outside
from support.finished import finished_run

pytest.importorskip("viser", reason="viser is not installed: pip install skymoor[view]")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    run = finished_run(tmp_path_factory.mktemp("viewed"))
    path = run / "summary.json"
    summary = json.loads(path.read_text())
    air = summary["sets"][0]["components"][0]
    air["surface_accuracy"]["similarity_covariance"] = np.diag([4e-4] * 7).tolist()
    air["scene_centre_enu"] = [0.0, 0.0, 4.0]
    path.write_text(json.dumps(summary))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shown = Page(Result.read(run), port)
    try:
        assert list(shown.load()) == []
        yield shown
    finally:
        shown.stop()


def drawn(page: Page) -> dict[str, bool]:
    """What is in the scene, and whether it is visible."""
    handles: dict[str, Any] = page._server.scene._handle_from_node_name
    return {name: bool(one.visible) for name, one in handles.items()}


def test_a_finer_surface_has_taken_the_place_of_the_coarse_one(page: Page) -> None:
    assert {name for name in drawn(page) if name.startswith(("/satellite/", "/model surface/"))} == {
        "/satellite/1 photos",
        "/model surface/1 photos",
    }
    with urllib.request.urlopen(page.address, timeout=60) as answer:
        assert b"<html" in answer.read().lower()


def test_confidence_takes_the_place_of_the_photos(page: Page) -> None:
    page._colours.value = "confidence"
    page._recolour()
    found = drawn(page)
    assert found["/model surface/1 confidence"] and not found["/model surface/1 photos"]
    assert found["/satellite/1 photos"] and page._legend.visible
    page._colours.value = "photos"
    page._recolour()
    assert drawn(page)["/model surface/1 photos"] and not drawn(page)["/model surface/1 confidence"]


def test_two_clicks_measure_and_a_third_starts_anew(page: Page) -> None:
    def click(east: float, north: float) -> None:
        tape._click(SimpleNamespace(ray_origin=(east, north, 90.0), ray_direction=(0.0, 0.0, -1.0)))

    tape = page._tape
    click(-6.0, 3.0)
    click(9.0, -2.0)
    distance = float(np.hypot(np.hypot(15.0, 5.0), tape._points[1][2] - tape._points[0][2]))
    assert f"{distance:.2f} m ±" in tape._words.content
    error = float(tape._words.content.partition("± ")[2].partition(" m")[0])
    scale, points = 0.02 * distance, 0.3 * 2**0.5  # of this run: see the fixture and its residuals
    assert error == pytest.approx(1.645 * np.hypot(scale, points), rel=0.1)
    click(1.0, 1.0)
    assert len(tape._points) == 1
    click(36.0, 36.0)  # beside the model, on the reference
    assert "accuracy is not known" in tape._words.content and "±" not in tape._words.content
    click(900.0, 0.0)
    assert "no surface" in tape._words.content


def test_a_chosen_camera_shows_its_photo_up_to_what_it_sees(page: Page) -> None:
    cameras = page._cameras
    cameras._choose("air/003.jpg")
    cameras._opacity.value = 40
    cameras._lay()
    overlay = cameras._overlay
    assert overlay.image.shape[-1] == 4 and set(np.unique(overlay.image[..., 3])) == {102}
    # viser divides a frustum by the cube root of a third of its volume: its depth is this again.
    depth = overlay.scale / frustum_scale(overlay.fov, overlay.aspect)
    assert depth == pytest.approx(0.9 * 36.0, rel=1e-6)
    assert not drawn(page)["/cameras/airborne_0/air/003.jpg"]
    cameras._choose("none")
    assert drawn(page)["/cameras/airborne_0/air/003.jpg"] and cameras._overlay is None


@needs_chromium
def test_nothing_is_asked_of_another_machine(page: Page, tmp_path: Path) -> None:
    log = tmp_path / "net.json"
    done = opened(page.address, tmp_path, f"--log-net-log={log}")
    assert 'id="root"><' in done.stdout.replace("\n", "")  # its script has drawn something
    told = log.read_text(encoding="utf-8")
    assert page.address.replace("http://", "ws://").rstrip("/") in told and "HTTP/1.1 101" in told  # and talks to it
    assert "HTTP/1.1 403" not in told  # and has all that it asks for
    assert outside(log) == set()
