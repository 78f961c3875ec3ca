# SPDX-License-Identifier: Apache-2.0
"""The examples of the documentation do what they say."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from skymoor.pipeline.option_parser import parse_option
from skymoor.simulate.site import Site
from support.examples import example
from support.exported_run import write_run
from support.finished import finished_run
from support.small_run import FASTER


def test_reading_a_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("read_a_result").main(finished_run(tmp_path), tmp_path / "figures")
    shown = capsys.readouterr().out
    assert (
        "something is not registered" in shown and "ground0_0 no wall fits" in shown and shown.count("ellipsoid") == 9
    )
    for name in ("cameras", "residuals", "stages"):
        page = (tmp_path / "figures" / f"{name}.html").read_text(encoding="utf-8")
        assert "<html" in page and "cdn.plot.ly/plotly" not in page


def test_exports_mean_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # The made-up observations are exact, and so must be what two formats say of them.
    assert example("export_and_check").main(write_run(tmp_path), tmp_path / "exports") < 1e-3
    assert "4 photos" in capsys.readouterr().out


@pytest.mark.e2e
def test_placing_photos(finished: Path, small_site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Goes on from a finished run of the same site with the same options, which is what makes it quick."""
    shutil.copytree(finished, tmp_path / "result")
    stages = {path.name for path in (tmp_path / "result" / "stages").iterdir()}
    options = dict(map(parse_option, FASTER[1::2]))
    example("place_photos").main(tmp_path, small_site.folder / "airborne.toml", options)
    assert stages == {path.name for path in (tmp_path / "result" / "stages").iterdir()}
    shown = capsys.readouterr().out
    assert "airborne_0: CE90" in shown and "m off, on average" in shown
