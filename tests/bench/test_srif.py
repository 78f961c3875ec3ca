# SPDX-License-Identifier: Apache-2.0
"""Pairs with a known transform, made here: the label is read rightly, and an error that is put in comes back."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from skymoor.bench import Answer, Row, by_kind, find_pairs, label_error_px, measure, search_and_match, similarity_from
from skymoor.bench.srif import inside_frame
from skymoor.cli.main import main
from skymoor.errors import InputError
from skymoor.types import Raster
from support.srif import SHAPE, write_pair

AZIMUTH_DEG, SCALE = -25.0, 1.2


def test_the_label_counts_from_the_middle_of_the_first_pixel(tmp_path: Path) -> None:
    write_pair(tmp_path, "Nighttime", "1", AZIMUTH_DEG, SCALE)
    (pair,) = find_pairs(tmp_path)
    label = np.loadtxt(tmp_path / "Nighttime" / "gt_1.txt")
    corner = pair.b_from_a @ [0.5, 0.5, 1.0]
    assert np.allclose(corner - 0.5, label[:, 2], atol=1e-9)


@pytest.mark.parametrize("shift", [0.0, 2.0, 50.0])
def test_an_error_of_the_answer_comes_back(tmp_path: Path, shift: float) -> None:
    write_pair(tmp_path, "Nighttime", "1", AZIMUTH_DEG, SCALE)
    (pair,) = find_pairs(tmp_path)
    moved = pair.b_from_a + [[0, 0, 0.6 * shift], [0, 0, -0.8 * shift]]
    assert label_error_px(moved, pair, (SHAPE, SHAPE)) == pytest.approx(shift, abs=1e-9)


def test_a_similarity_is_found_among_wrong_matches_and_not_in_chance(rng: np.random.Generator) -> None:
    px = rng.uniform(0, 200, (60, 2))
    true = np.array([[0.8, -0.6, 30.0], [0.6, 0.8, -5.0]])
    there = px @ true[:, :2].T + true[:, 2]
    there[:20] = rng.uniform(0, 200, (20, 2))
    answer = similarity_from(px, there)
    assert answer.b_from_a is not None and np.allclose(answer.b_from_a, true, atol=1e-6)
    assert 40 <= answer.inliers < 45
    assert similarity_from(px[:3], there[:3]).b_from_a is None


def test_a_measurement_goes_on_where_it_stopped(tmp_path: Path) -> None:
    for name in "12":
        write_pair(tmp_path, "Nighttime", name, AZIMUTH_DEG, SCALE)
    pairs, log, calls = find_pairs(tmp_path), tmp_path / "log.jsonl", []

    def identity(a: Raster, b: Raster) -> Answer:
        calls.append(a)
        return Answer(np.eye(2, 3), 7)

    first = measure(identity, "identity", pairs[:1], log, "code")
    with log.open("a") as out:
        out.write('{"method": "identity", "kind"')  # as a kill leaves it
    both = measure(identity, "identity", pairs, log, "code")
    assert len(calls) == 2 and both[0] == first[0]
    assert len(log.read_text().splitlines()) == 2
    assert both[1].error_px is not None and both[1].error_px > 10
    measure(identity, "identity", pairs, log, "other code")
    assert len(calls) == 4


def test_a_file_of_something_else_is_not_written_to(tmp_path: Path) -> None:
    write_pair(tmp_path, "Nighttime", "1", AZIMUTH_DEG, SCALE)
    log = tmp_path / "notes.jsonl"
    for text in ("my notes", "my notes\n", '{"a": 1}\n'):
        log.write_text(text)
        with pytest.raises(InputError, match=r"notes\.jsonl: is no log"):
            measure(search_and_match, "ours", find_pairs(tmp_path), log, "code")
        assert log.read_text() == text


def test_no_answer_counts_as_the_diagonal() -> None:
    rows = [Row("m", "k", str(n), error, 100.0, 2.0, 0, None, "") for n, error in enumerate((2.0, 4.0, 7.0, None, 1e6))]
    (row,) = by_kind(rows)
    assert (row.pairs, row.answers, row.within) == (5, 4, (1, 2, 3))
    assert row.mean_error_px == pytest.approx((2 + 4 + 7 + 100 + 100) / 5)
    assert row.median_error_px == 7.0


def test_the_command_finds_a_turned_negative_and_writes_it_down(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skymoor.bench.method.SCALES", (1.0, 1.3))  # a fifth of the time
    write_pair(tmp_path / "data", "Nighttime", "3", AZIMUTH_DEG, SCALE)
    write_pair(tmp_path / "data", "Optical-SAR", "1", AZIMUTH_DEG, SCALE)
    arguments = ["bench", "srif", str(tmp_path / "data"), "--out", str(tmp_path / "out"), "--quiet"]
    assert main(arguments) == 0
    told = capsys.readouterr().out
    assert "Nighttime" in told and "Optical-SAR is left out: its labels contradict" in told
    record = json.loads((tmp_path / "out/srif.json").read_text())
    assert {"machine", "date", "skymoor", "code", "left_out"} <= set(record)
    (kind,) = record["kinds"]
    assert kind["kind"] == "Nighttime" and kind["pairs"] == 1 and kind["within"] == [1, 1, 1]
    # The second image is resampled and noisy: an exact answer would have seen the label.
    assert 0.001 < record["pairs"][0]["error_px"] < 1.5 and record["pairs"][0]["inliers"] > 50
    log = (tmp_path / "out/srif.jsonl").read_text()
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pairs"] == record["pairs"]
    assert (tmp_path / "out/srif.jsonl").read_text() == log


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda kind: (kind / "pair1_2.png").unlink(), "pair1_2.jpg: is missing"),
        (lambda kind: (kind / "pair1_1.png").write_bytes(b"\x89PNG"), "pair1_1.png: cannot be read as an image"),
        (lambda kind: (kind / "gt_1.txt").write_text("1 0 0\n0 1\n"), "gt_1.txt: is no transform of 2 x 3 numbers"),
        (lambda kind: (kind / "gt_1.txt").write_text("1 0 0\n0 nan 0\n"), "gt_1.txt: is no transform"),
        (lambda kind: (kind / "gt_1.txt").write_text("1 0 9999\n0 1 0\n"), "beside the second image"),
        (lambda kind: (kind / "gt_1.txt").unlink(), "has no pairs of Nighttime, Optical-Infrared"),
        (lambda kind: kind.rename(kind.with_name("night")), "give the folder of the SRIF data set"),
    ],
)
def test_a_broken_pair_or_a_wrong_folder_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: object, line: str
) -> None:
    kind = write_pair(tmp_path / "data", "Nighttime", "1", AZIMUTH_DEG, SCALE)
    assert callable(spoil)
    spoil(kind)
    assert main(["bench", "srif", str(tmp_path / "data"), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    (told,) = [one for one in capsys.readouterr().err.splitlines() if one.startswith("skymoor: ")]
    assert line in told
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "srif", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == 2
    assert "none: is no folder; give that of the SRIF data set" in capsys.readouterr().err


def test_what_is_beyond_the_frame_is_masked_and_dark_content_is_not() -> None:
    h, w = 120, 160
    turn = cv2.getRotationMatrix2D((w / 2, h / 2), 20, 0.95)
    true = cv2.warpAffine(np.ones((h, w), np.uint8), turn, (w, h)) > 0
    rgb = np.where(true, 130, 3).astype(np.uint8)[..., None].repeat(3, axis=2)
    rgb[50:70, 60:100] = 0  # a dark roof
    rgb[(true.argmax(axis=0) + 6).clip(0, h - 1)[80] :, 78:82] = 0  # a dark road out of the frame
    mask = inside_frame(rgb)
    differ = (mask != true).mean()
    assert 0 < differ < 0.02 and mask[60, 80] and not mask[0, 0]
    assert inside_frame(np.full((h, w, 3), 90, np.uint8)).all()
    assert inside_frame(np.zeros((h, w, 3), np.uint8)).all()


def test_a_grey_image_is_read(tmp_path: Path) -> None:
    kind = write_pair(tmp_path, "Nighttime", "1", AZIMUTH_DEG, SCALE)
    grey = cv2.imread(str(kind / "pair1_1.png"), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(kind / "pair1_1.png"), grey)
    a, _ = find_pairs(tmp_path)[0].rasters()
    assert a.rgb.shape == (*SHAPE, 3)
