# SPDX-License-Identifier: Apache-2.0
"""The scene of a run, and the viewer that shows it."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import urllib.request
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from skymoor.cli.main import main
from skymoor.errors import InputError
from skymoor.geo import Grid
from skymoor.results.read import Result
from skymoor.results.viewer import Layer, draped, parts_of
from skymoor.results.viewer.scene import Part
from skymoor.results.viewer.surfaces import LEVELS, confidence_colours
from support.finished import finished_run


def layers_of(parts: list[Part]) -> list[Layer]:
    return [part for part in parts if isinstance(part, Layer)]


def test_everything_lies_in_the_same_metres(tmp_path: Path) -> None:
    parts = list(parts_of(Result.read(finished_run(tmp_path))))
    layers = {layer.name: layer for layer in layers_of(parts)}
    assert set(layers) == {"satellite", "model surface", "point cloud"}
    surface, cloud = layers["model surface"].points, layers["point cloud"].points
    assert np.abs(np.median(surface, axis=0) - np.median(cloud, axis=0)).max() < 0.6
    assert layers["satellite"].faces is not None and layers["satellite"].faces.max() < len(layers["satellite"].points)
    ((frustums,),) = [part.values() for part in parts if isinstance(part, dict)]
    assert len(frustums) == 9
    np.testing.assert_allclose(frustums[0].position, [20, 0, 40], atol=1e-6)
    np.testing.assert_array_equal(frustums[0].enu_from_camera_wxyz, [0, -1, 0, 0])
    assert not [part for part in parts if isinstance(part, str)]


def test_a_coarse_surface_comes_first_and_a_finer_one_takes_its_place(tmp_path: Path) -> None:
    """The run's grid has 6400 cells, so the levels are made smaller than it here."""
    result = Result.read(finished_run(tmp_path))
    assert list(LEVELS) == sorted(LEVELS) and LEVELS[0] <= 20_000
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skymoor.results.viewer.surfaces.LEVELS", (400, 3000))
        surfaces = [one for one in layers_of(list(parts_of(result))) if one.faces is not None]
    names = [(one.name, one.level) for one in surfaces]
    assert names == [("satellite", 0), ("model surface", 0), ("satellite", 1), ("model surface", 1)]
    for coarse, fine in zip(surfaces[:2], surfaces[2:], strict=True):
        assert 4 * len(coarse.points) < len(fine.points) <= 3300
        extents = [np.ptp(one.points[:, :2], axis=0) for one in (coarse, fine)]
        np.testing.assert_allclose(extents[0], extents[1], atol=8.0)  # a cell of the coarse one is 4 m


def test_confidence_is_that_of_the_raster_and_has_its_colours(tmp_path: Path) -> None:
    layers = {layer.name: layer for layer in layers_of(list(parts_of(Result.read(finished_run(tmp_path)))))}
    for name in ("model surface", "point cloud"):
        sure = layers[name].confidence
        assert sure is not None and len(sure) == len(layers[name].points)
        assert np.mean(sure == 90) > 0.95
    assert layers["satellite"].confidence is None
    colours = confidence_colours(np.array([0, 1, 50, 100], np.uint8)).astype(int)
    assert len(set(colours[0].tolist())) == 1  # grey: it was interpolated
    assert colours[1, 2] > colours[1, 1] and colours[3, 0] > 200 and colours[3, 1] > 200  # from violet to yellow


def test_photos_that_have_moved_are_told_once(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    summary = json.loads((run / "summary.json").read_text())
    summary["sets"][0]["folder"] = str(tmp_path / "moved")
    (run / "summary.json").write_text(json.dumps(summary))
    parts = list(parts_of(Result.read(run)))
    (note,) = [part for part in parts if isinstance(part, str)]
    assert str(tmp_path / "moved") in note and "not where the run found it" in note
    assert [len(one) for part in parts if isinstance(part, dict) for one in part.values()] == [9]


def test_a_draped_surface_has_no_triangle_over_a_hole() -> None:
    height = np.zeros((4, 5), np.float32)
    height[1, 2] = np.nan
    layer = draped("x", Grid(0.0, 4.0, 1.0, (4, 5)), np.zeros((4, 5, 3), np.uint8), height)
    assert layer.faces is not None
    assert len(layer.points) == 19
    assert len(layer.faces) == 2 * (3 * 4 - 4)
    corners = layer.points[layer.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0).all()  # seen from above


def test_a_run_without_anything_on_earth_is_told(tmp_path: Path) -> None:
    run = finished_run(tmp_path, registered=False)
    (tmp_path / "dsm.tif").unlink()
    with pytest.raises(InputError, match=r"nothing of this run is registered"):
        list(parts_of(Result.read(run)))


@pytest.mark.parametrize("port", ["0", "65536"])
def test_a_port_that_is_none_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], port: str) -> None:
    assert main(["view", str(finished_run(tmp_path)), "--port", port]) == 2
    assert f"--port {port}" in capsys.readouterr().err


@pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed: pip install skymoor[view]")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_viewer_answers_until_it_is_interrupted(tmp_path: Path, number: int) -> None:
    run = finished_run(tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # A process of its own: viser leaves sockets and an event loop to the end of the process.
    # A background job's children are born deaf to Ctrl+C.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code = listen + f"from skymoor.cli.main import main; main(['view', {str(run)!r}, '--port', '{port}', '--no-open'])"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen([sys.executable, "-u", "-c", code], **pipes, text=True) as viewer:
        try:
            assert viewer.stdout is not None
            address, _, told = viewer.stdout.readline().partition(": the viewer")
            assert address.startswith(f"http://127.0.0.1:{port}/") and told
            with urllib.request.urlopen(address, timeout=120) as answer:
                assert b"<html" in answer.read().lower()
            viewer.send_signal(number)
            assert viewer.stdout.read() == "stopped\n"  # of COLMAP's stack trace, nothing
            assert viewer.wait(120) == 0
        finally:
            viewer.kill()
