# SPDX-License-Identifier: Apache-2.0
"""What is said of a user's files on the screen, in summary.json and in the report; and a pipe that is closed."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from skymoor.cli.main import main
from support.tiny_site import make_site, picture


def arguments(site: Path, *sources: Path) -> list[str]:
    airborne = [word for source in sources for word in ("--airborne", str(source))]
    reference = ["--ortho", str(site / "ortho.tif"), "--dsm", str(site / "dsm.tif"), "--vertical-datum", "ellipsoid"]
    return ["run", *airborne, *reference, "--ce90", "2.5", "--le90", "3.8", "--out", str(site / "out")]


def test_two_folders_sub_folders_and_unreadable_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    (site / "second/100MEDIA").mkdir(parents=True)
    Image.fromarray(picture(7)).save(site / "second/100MEDIA/0.png")
    (site / "airborne/IMG.DNG").write_bytes(b"?")
    assert main(arguments(site, site / "airborne", site / "second")) == 3
    lines = capsys.readouterr().out.splitlines()
    told = [line for line in lines if "left out: 1 raw photo (airborne/IMG.DNG)" in line and "develop to JPEG" in line]
    assert len(told) == 1 and any("1 of 1 photos are in sub-folders: 100MEDIA (1)" in line for line in lines)
    (found,) = json.loads((site / "out/summary.json").read_text())["sets"]
    assert found["n_images"] == 5 and told[0] in found["notes"]
    assert [source["name"] for source in found["sources"]] == ["airborne", "second"]
    assert "airborne/IMG.DNG" in (site / "out/report.html").read_text()
    with (site / "out/cameras.csv").open() as file:
        assert [row["image"] for row in csv.DictReader(file)][-1] == "second/100MEDIA/0.png"


def test_nothing_is_written_where_nothing_can_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    for photo in (site / "airborne").iterdir():
        photo.rename(photo.with_suffix(".nef"))
    assert main(arguments(site, site / "airborne")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "airborne: has no images" in line and "4 raw photos (airborne/0.nef" in line and "develop to JPEG" in line
    assert not (site / "out").exists()


def test_no_photos_at_all_names_both_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments(make_site(tmp_path))) == 2
    assert "give --airborne FOLDER, or --ground FOLDER" in capsys.readouterr().err


def test_frames_per_second_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("av")
    site = make_site(tmp_path)
    (site / "airborne/v.mp4").write_bytes(b"?")
    assert main([*arguments(site, site / "airborne"), "--fps", "0"]) == 2
    assert "video.fps = 0.0: give frames per second above 0" in capsys.readouterr().err
    assert not (site / "out").exists()


@pytest.mark.skipif(os.name == "nt", reason="has no such signal")
def test_a_closed_pipe_ends_quietly_with_the_status_of_its_signal() -> None:
    code = "from skymoor.cli.main import main; raise SystemExit(main(['weights', 'list']))"
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, check=False)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")
