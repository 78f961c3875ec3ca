# SPDX-License-Identifier: Apache-2.0
"""A finished run in a notebook: its table, its errors and its figures."""

from __future__ import annotations

import base64
import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

import skymoor
from skymoor import plot_cameras, plot_residuals, plot_stages
from skymoor.results.read import Result
from support.finished import HOSTILE, finished_run


@pytest.fixture
def result(tmp_path: Path) -> Result:
    return Result.read(finished_run(tmp_path))


def test_the_table_says_every_set_and_escapes_it(result: Result) -> None:
    table = result._repr_html_()
    assert HOSTILE not in table and "<script" not in table and "&lt;script&gt;" in table
    assert table.count("<tr>") == 1 + 4  # two ground components, and the set that was lost
    for words in ("2.10", "3.80", "no wall fits", "no two photos agree", "ground1"):
        assert words in table


def test_the_map_has_the_cameras_of_the_table(result: Result) -> None:
    figure = plot_cameras(result)
    (trace,) = figure.data
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
