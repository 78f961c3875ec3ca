# SPDX-License-Identifier: Apache-2.0
"""A run's folder read back."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity
from skymoor.results.formats import cameras_table, georeference
from skymoor.results.read import Result
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow

FRAME = EnuFrame(48.0, 11.0, 500.0)
ENU_FROM_SFM = Similarity.from_quaternion_wxyz(12.5, [0.5, 0.5, -0.5, 0.5], [1.0, -2.0, 30.0])
PLACED = CameraRow("air/ä 1.jpg", "airborne", 0, "REGISTERED", 48.0, 11.0, 530.0, *([0.25] * 7), 2.1, 3.8, 0.1, 0.2)
LOST = CameraRow("air/2.jpg", "airborne", None, "NOT_REGISTERED")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a run of two photos, one of which has a place."""
    (tmp_path / "air").mkdir()
    (tmp_path / "air" / "ä 1.jpg").write_bytes(b"")
    component = {"component": 0, "status": "REGISTERED", "reason": "", "scene_centre_enu": [1.0, 2.0, 3.0]}
    component |= georeference(FRAME, ENU_FROM_SFM) | {"predicted_ce90_m": 2.1, "predicted_le90_m": 3.8}
    lost = {"component": 1, "status": "NOT_REGISTERED", "reason": "too few matches"}
    one = {
        "set": "airborne",
        "folder": str(tmp_path / "air"),
        "status": "NOT_REGISTERED",
        "components": [component, lost],
    }
    summary = {
        "reference": {"covariance_m2": np.diag([1.0, 1.0, 2.0]).tolist()},
        "enu_origin": {"lat": 48.0, "lon": 11.0, "height": 500.0},
        "sets": [one | {"components": [component, lost]}],
    }
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with (tmp_path / "cameras.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, CAMERA_COLUMNS)
        writer.writeheader()
        writer.writerows(cameras_table([PLACED, LOST]))
    return tmp_path


def test_what_was_written_comes_back(run: Path) -> None:
    result = Result.read(run)
    assert result.cameras == (PLACED, LOST)
    assert not result.registered
    first, second = result.components
    assert (first.name, first.registered, first.ce90_m) == ("airborne_0", True, 2.1)
    assert (second.registered, second.reason, second.enu_from_sfm) == (False, "too few matches", None)
    assert first.enu_from_sfm is not None
    np.testing.assert_allclose(first.enu_from_sfm.matrix(), ENU_FROM_SFM.matrix(), atol=1e-12)
    np.testing.assert_array_equal(result.scene_centres()["airborne", 0], [1, 2, 3])
    assert list(result.scene_centres()) == [("airborne", 0)]


def test_photos_of_sub_folders_other_folders_and_videos_are_found(run: Path, tmp_path: Path) -> None:
    files = {
        "air/100MEDIA/1.jpg": run / "air/100MEDIA/1.jpg",
        "second/100MEDIA/1.jpg": tmp_path / "elsewhere/second/100MEDIA/1.jpg",
        "air/flight.mp4/000012.jpg": run / "frames/air/flight.mp4/000012.jpg",
    }
    for path in files.values():
        path.parent.mkdir(parents=True)
        path.write_bytes(b"")
    summary = json.loads((run / "summary.json").read_text())
    places = {"air": run / "air", "second": tmp_path / "elsewhere/second"}
    summary["sets"][0]["sources"] = [{"path": str(path), "name": name} for name, path in places.items()]
    (run / "summary.json").write_text(json.dumps(summary))
    with (run / "cameras.csv").open("a", encoding="utf-8", newline="") as file:
        csv.DictWriter(file, CAMERA_COLUMNS).writerows(cameras_table([replace(LOST, image=name) for name in files]))
    result = Result.read(run)
    assert {name: result.photo(name) for name in files} == files
    (run / "air/100MEDIA/1.jpg").unlink()
    with pytest.raises(InputError, match=r"air/100MEDIA/1\.jpg: the photo is not where the run found it"):
        result.photo("air/100MEDIA/1.jpg")


def test_photos_are_found_where_the_run_read_them(run: Path) -> None:
    result = Result.read(run)
    assert result.photo("air/ä 1.jpg") == run / "air" / "ä 1.jpg"
    with pytest.raises(InputError, match=r"2\.jpg: the photo is not where the run found it"):
        result.photo("air/2.jpg")
    with pytest.raises(InputError, match=r"3\.jpg: the photo is not where the run found it"):
        result.photo("air/3.jpg")


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"enu_origin": {"lat": "x"}}'])
def test_a_damaged_summary_is_told(run: Path, content: str) -> None:
    (run / "summary.json").write_text(content)
    with pytest.raises(InputError, match=r"summary\.json: no summary of a finished run"):
        Result.read(run)


def test_a_folder_that_is_none_of_a_run_is_told_in_words(run: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere: there is no such folder; name the one that skymoor run wrote"):
        Result.read(run / "nowhere")
    with pytest.raises(InputError, match=r"air: is not the folder of a finished run, it has no summary\.json"):
        Result.read(run / "air")


def test_columns_that_a_former_version_did_not_write_are_none(run: Path) -> None:
    lines = (run / "cameras.csv").read_text(encoding="utf-8").splitlines()
    former = [",".join(line.split(",")[:-3]) for line in lines]
    (run / "cameras.csv").write_text("\n".join(former), encoding="utf-8")
    assert Result.read(run).cameras == (replace(PLACED, relative_ce90=None, relative_le90=None), LOST)
