# SPDX-License-Identifier: Apache-2.0
"""`skymoor simulate` and `skymoor demo`: a site from nothing, placed, and compared with its own truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skymoor.cli import commands
from skymoor.cli.main import main
from skymoor.simulate.options import SiteOptions
from support.small_run import OPTIONS

SMALL = SiteOptions(
    seed=1,
    radius_m=34.0,
    airborne=12,
    groups=0,
    security=0,
    photo_width=400,
    samples=1,
    reference_width_m=150.0,
    ortho_pixel_m=0.5,
)


@pytest.mark.e2e
def test_the_demo_finds_the_site_that_it_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commands, "DEMO", SMALL)
    # Less to search, for time only; but all decoys: so few small photos score not far above them.
    real, fewer = commands.run, (*OPTIONS, "match.decoys.count=4")
    monkeypatch.setattr(commands, "run", lambda command: real(replace(command, set=fewer)))
    assert main(["demo", "--out", str(tmp_path), "--quiet"]) == 0
    truth = json.loads((tmp_path / "site/truth.json").read_text())
    (row,) = json.loads((tmp_path / "result/evaluation.json").read_text())["rows"]
    assert row["status"] == "REGISTERED" and row["n_cameras"] == 12
    # The reference's bias stays, for nobody can know it; twelve small photos add less than 1 % of the standoff.
    assert row["mean_absolute_m"] == pytest.approx(np.linalg.norm(truth["bias_m"]), abs=0.6)
    assert 0.001 < row["mean_relative_m"] < 0.6
    shown = capsys.readouterr().out
    assert "REGISTERED" in shown and str(tmp_path / "result/summary.json") in shown
    made = {path: path.stat().st_mtime_ns for path in (tmp_path / "result/stages").glob("*.npz")}
    assert main(["demo", "--out", str(tmp_path), "--quiet"]) == 0
    assert made == {path: path.stat().st_mtime_ns for path in made}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--airborne", "0"], "airborne = 0"),
        (["--radius-m", "-5"], "radius_m = -5.0"),
        (["--groups", "30"], "groups = 30"),
    ],
)
def test_impossible_sites_are_refused(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--out", str(tmp_path / "site"), *arguments]) == 2
    shown = capsys.readouterr().err
    assert words in shown and shown.count("\n") == 1
    assert not (tmp_path / "site").exists()


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "site.toml").write_text("mine")
    assert main(["simulate", "--out", str(tmp_path), "--airborne", "3"]) == 2
    assert str(tmp_path) in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["site.toml"]
