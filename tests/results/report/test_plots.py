# SPDX-License-Identifier: Apache-2.0
"""A finished run in a notebook: its table, its errors and its figures."""

from __future__ import annotations

import base64
import csv
import re
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import skymoor
from skymoor import plot_cameras, plot_residuals, plot_stages
from skymoor.results.read import Result
from skymoor.results.report.table import summary_html
from support.finished import HOSTILE, finished_run


@pytest.fixture
def result(tmp_path: Path) -> Result:
    return Result.read(finished_run(tmp_path))


def test_the_table_says_every_set_and_escapes_it(result: Result) -> None:
    table = summary_html(result.summary)
    assert HOSTILE not in table and "<script" not in table and "&lt;script&gt;" in table
    assert table.count("<tr>") == 1 + 4  # two ground components, and the set that was lost
    for words in ("2.10", "3.80", "no wall fits", "no two photos agree", "ground1"):
        assert words in table


def test_a_notebook_shows_verdict_table_and_map_without_a_network(result: Result) -> None:
    shown = result._repr_html_()
    words, _, page = shown.partition("<table>")
    assert "Registered in part: 1 of 4 components have an accepted position." in words
    assert "airborne_0: Nine of ten cameras are expected within 2.1 m in plan and 3.8 m in height of the truth" in words
    assert "ground0_0: Refused: no wall fits." in words and "ground1: Refused: no two photos agree." in words
    assert summary_html(result.summary) in shown and HOSTILE not in words
    # Plotly's script is in it, and the orthophoto; nothing is loaded from elsewhere.
    assert "Plotly.newPlot" in page and "data:image/png;base64," in page
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=", page)


def test_the_verdict_of_all_or_nothing(tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    refused = Result.read(finished_run(tmp_path / "none", registered=False))._repr_html_()
    assert "Not registered: no position was accepted." in refused and "Plotly" not in refused
    result = Result.read(finished_run(tmp_path))
    result.summary["sets"] = result.summary["sets"][:1]
    placed = replace(result, components=result.components[:1])._repr_html_()
    assert "Registered: every component has an accepted position." in placed


def test_words_and_table_are_there_without_the_map(result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    (result.folder / "cameras.csv").write_text("damaged", encoding="utf-8")
    damaged = result._repr_html_()
    assert "Registered in part" in damaged and "<table>" in damaged and "Plotly" not in damaged
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    assert "Plotly" not in Result.read(result.folder)._repr_html_()


def test_circles_have_the_radius_of_ce90(result: Result) -> None:
    _, circles = plot_cameras(result).data
    assert circles.name == "CE90" and circles.mode == "lines"
    xy = np.column_stack([circles.x, circles.y]).reshape(9, -1, 2)[:, :-1]  # a gap after each
    places = np.array([[row.east, row.north] for row in result.registered_cameras])
    np.testing.assert_allclose(np.linalg.norm(xy - places[:, None], axis=2), 2.1, atol=1e-9)
    on_map, around = plot_cameras(result, basemap=True).data
    np.testing.assert_allclose(on_map.lat, [row.lat for row in result.registered_cameras])
    here = np.column_stack([around.lat, around.lon]).reshape(9, -1, 2)[:, :-1]
    enu = result.frame.enu_from_lla(*here.reshape(-1, 2).T, 0.0)[:, :2].reshape(here.shape)
    np.testing.assert_allclose(enu, xy, atol=0.02)


def test_tiles_are_asked_for_only_with_a_basemap(result: Result) -> None:
    assert not plot_cameras(result).layout.map.style
    figure = plot_cameras(result, basemap=True)
    assert figure.layout.map.style == "open-street-map" and 14 < figure.layout.map.zoom < 22
    (layer,) = figure.layout.map.layers
    west, north = layer.coordinates[0]
    assert west == pytest.approx(11.0 - 40 / 74_600, abs=5e-5) and north == pytest.approx(48.0 + 40 / 111_200, abs=5e-5)
    bare = replace(result, summary=result.summary | {"sets": []})
    (result.folder / "ortho.tif").unlink()
    assert not plot_cameras(bare, basemap=True).layout.map.layers


def test_the_map_has_the_cameras_of_the_table(result: Result) -> None:
    figure = plot_cameras(result)
    trace, _ = figure.data
    placed = [row for row in result.cameras if row.east is not None]
    np.testing.assert_array_equal(trace.x, [row.east for row in placed])
    np.testing.assert_array_equal(trace.y, [row.north for row in placed])
    assert trace.name == "airborne_0" and figure.layout.yaxis.scaleanchor == "x"
    assert trace.customdata[0][0] == "air/&lt;b&gt;ä &amp; 駅.jpg"
    assert trace.customdata[0][1] == "up 40.00 m, CE90 2.10 m, LE90 3.80 m"
    assert "9 of 10 cameras" in figure.layout.title.text and "<script" not in figure.layout.title.text


def test_the_map_lies_on_the_model_and_the_reference(result: Result) -> None:
    (image,) = plot_cameras(result).layout.images
    west, south, east, north = -40.0, -40.0, 40.0, 40.0
    place = (image.x, image.y, image.x + image.sizex, image.y - image.sizey)
    assert np.allclose(place, (west, north, east, south), atol=3.0)  # the frame is wider than the files
    png = np.frombuffer(base64.b64decode(image.source.partition(",")[2]), np.uint8)
    alpha = cv2.imdecode(png, cv2.IMREAD_UNCHANGED)[..., 3]
    middle = tuple(side // 2 for side in alpha.shape)
    assert alpha[middle] == 255 and 0 < alpha[2, 2] < 255


def test_a_map_without_any_place(tmp_path: Path) -> None:
    folder = finished_run(tmp_path, registered=False)
    for name in ("ortho.tif", "dsm.tif"):
        (tmp_path / name).unlink()
    figure = plot_cameras(Result.read(folder))
    assert not figure.data and not figure.layout.images


def test_residuals_are_those_of_the_matches(result: Result) -> None:
    with np.load(result.folder / "matches" / "airborne_0.npz") as arrays:
        metres = arrays["residuals_m"]
    figure = plot_residuals(result)
    assert len(figure.data) == 3
    for k, (trace, axis) in enumerate(zip(figure.data, ("east", "north", "up"), strict=True)):
        np.testing.assert_array_equal(trace.x, metres[:, k])
        assert trace.name.startswith(f"airborne_0 {axis}: median")
    (result.folder / "matches" / "airborne_0.npz").write_bytes(b"")
    with pytest.raises(skymoor.InputError, match="there are no residuals"):
        plot_residuals(result)


def test_stages_follow_each_other(result: Result) -> None:
    stage = result.summary["stages"][0]
    result.summary["stages"] = [stage, stage | {"name": "match", "seconds": 5.0, "cached": True}]
    (trace,) = plot_stages(result).data
    assert list(trace.base) == [0.0, 75.0] and list(trace.x) == [75.0, 5.0] and list(trace.y) == ["photos", "match"]
    assert len(set(trace.marker.color)) == 2


def test_errors_against_the_truth(result: Result, tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    with truth.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["image", "lat", "lon", "height"])
        for row in result.cameras:
            if row.height is not None:
                writer.writerow([row.image, row.lat, row.lon, row.height - 1.5])
    first = result.evaluate(truth)[0]
    assert (first.set, first.component, first.n_truth) == ("airborne", 0, 9)
    assert first.mean_absolute_m == pytest.approx(1.5, abs=1e-6) and first.bias_up_m == pytest.approx(1.5, abs=1e-6)
