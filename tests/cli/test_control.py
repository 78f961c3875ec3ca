# SPDX-License-Identifier: Apache-2.0
"""Control on the command line: wrong files are one line and exit status 2, and what was asked for is kept."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from skymoor.cli.main import main
from skymoor.results.read import Result
from skymoor.results.request import site_of_run
from support.tiny_site import make_site

# The tiny site lies at 27.12 degrees north and 81 west, and its photos have 64 by 48 pixels.
POSITION = "image,lat,lon,height,sigma_h,sigma_v\n0.png,27.12220,-81.00000,60,0.02,0.03\n"
LIST = "EPSG:4326\n-81.0 27.1222 10 20 30 0.png A\n-81.0 27.1222 10 22 31 airborne/1.png A\n"
DATUM = ("--control-datum", "ellipsoid")
STATED = (*DATUM, "--control-ce90", "0.05", "--control-le90", "0.1")


def run(site: Path, text: str, *more: str) -> int:
    (site / "given.txt").write_text(text, encoding="utf-8")
    arguments = ["run", str(site / "site.toml"), "--out", str(site / "out"), "--quiet"]
    return main([*arguments, "--control", str(site / "given.txt"), *more])


def test_what_was_asked_for_is_kept(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    assert run(site, LIST, *STATED, "--use-control") == 3  # nothing is reconstructed of noise
    with (site / "out/control.csv").open(newline="") as file:
        assert list(csv.DictReader(file)) == []
    request = json.loads((site / "out/summary.json").read_text())["request"]["control"]
    assert request["use"] and request["ce90"] == 0.05 and request["files"] == [str(site / "given.txt")]
    control = site_of_run(Result.read(site / "out")).control
    assert control is not None and control.given is not None and control.use
    assert [point.name for point in control.given.points] == ["A"]
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out"), "--quiet"]) == 3
    assert not (site / "out/control.csv").exists()
    assert site_of_run(Result.read(site / "out")).control is None


@pytest.mark.parametrize(
    ("text", "more", "words"),
    [
        (POSITION.replace("27.12220,-81.00000", "-81.00000,27.12220"), DATUM, "line 2: 0.png lies at latitude -81.0"),
        (POSITION.replace("0.png", "O.png"), DATUM, "line 2: none of the photos named there is in the site, such as O"),
        (LIST.replace("20 30", "20 300"), STATED, "line 2: pixel 20.5 300.5 lies outside of airborne/0.png"),
        (LIST.replace("20 30", "nan 30"), STATED, "line 2: px = nan must be a finite number"),
        (LIST, DATUM, "the accuracy of the control is not stated: write ce90 = M and le90 = M in [control], or give"),
        (LIST, STATED[2:], "the vertical datum of the control is not stated"),
        ("", STATED, "is empty"),
    ],
)
def test_what_is_wrong_is_one_line(
    text: str, more: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = make_site(tmp_path)
    assert run(site, text, *more) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line and "given.txt" in line
    assert not (site / "out/summary.json").exists()


def test_a_file_that_a_run_would_replace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    (site / "out").mkdir()
    (site / "out/control.csv").write_text(POSITION, encoding="utf-8")
    arguments = ["run", str(site / "site.toml"), "--out", str(site / "out"), "--control", str(site / "out/control.csv")]
    assert main([*arguments, *DATUM]) == 2
    assert "lies where the results would be written" in capsys.readouterr().err
    assert (site / "out/control.csv").read_text(encoding="utf-8") == POSITION


def test_flags_without_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    arguments = ["run", str(site / "site.toml"), "--out", str(site / "out"), "--use-control"]
    assert main(arguments) == 2
    assert "there is no control; give --control FILE" in capsys.readouterr().err
