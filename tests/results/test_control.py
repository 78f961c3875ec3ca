# SPDX-License-Identifier: Apache-2.0
"""Control in the summary, the table, the report and on the screen: every figure of it, and none where there is none."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from skymoor.cli.tables import control_lines, control_tables
from skymoor.control import Control, ControlResult, examine
from skymoor.results.control import CONTROL_COLUMNS, control_summary, control_table, controlled_components
from skymoor.results.read import Result
from skymoor.results.report.control import control_parts
from skymoor.results.report.page import report_page
from skymoor.store import plain
from support.finished import HOSTILE, finished_run
from support.surveyed import FRAME, PRIOR, SIX, registered, surveyed

ERROR = np.array([0.0, 0, 0, 0, 0.5, -0.4, 1.0])


@pytest.fixture
def found(rng: np.random.Generator) -> ControlResult:
    """Six points of which one is wrong, three cameras and a scale bar; used."""
    off = {4: np.array([0.0, 3.0, 0.0])}
    control = surveyed(rng=rng, off=off, positions=[0, 4, 8], bars=[(0, 2, 1.0)], use=True)
    result = examine(control, registered(ERROR), FRAME, PRIOR)
    assert result is not None and result.used
    return result


def summary_with(found: ControlResult | None, folder: Path) -> Path:
    """A finished run whose airborne component has this control."""
    run = finished_run(folder)
    summary = json.loads((run / "summary.json").read_text())
    summary["sets"][0]["components"][0]["control"] = plain(control_summary(found))
    (run / "summary.json").write_text(json.dumps(summary))
    return run


def test_the_table_has_every_row(found: ControlResult) -> None:
    rows = control_table([("airborne", 0, found), ("airborne", 1, None)])
    assert len(rows) == 10 and all(set(row) == set(CONTROL_COLUMNS) for row in rows)
    uses = {row["name"]: row["use"] for row in rows}
    assert uses["P4"] == "wrong" and uses["P0 to P2"] == "control" and rows[0]["component"] == 0
    bar = rows[-1]
    assert bar["east_m"] == "" and abs(float(str(bar["length_m"]))) < 0.5 and bar["ratio"] != ""
    point = rows[0]
    assert point["length_m"] == "" and point["reason"] == ""
    assert float(str(point["east_m"])) == pytest.approx(-0.5, abs=0.3)
    assert abs(float(str(point["after_east_m"]))) < 0.3


def test_the_summary_is_plain_json(found: ControlResult, tmp_path: Path) -> None:
    assert control_summary(None) is None
    again = json.loads(json.dumps(plain(control_summary(found)), allow_nan=False))
    assert again["used"] and len(again["points"]) == 10 and len(again["correction"]) == 8
    assert again["totals"]["n"] == 8 and again["notes"][0].startswith("P4 contradicts the others")
    run = summary_with(found, tmp_path)
    assert [name for name, _ in controlled_components(Result.read(run).summary)] == ["airborne 0"]


def test_the_screen_names_what_is_wrong(found: ControlResult, tmp_path: Path) -> None:
    summary = Result.read(summary_with(found, tmp_path)).summary
    (table,) = control_tables(summary)
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(table)
    text = console.export_text()
    assert "airborne 0: control that was used" in text and "P4" in text and "wrong" in text and "of length" in text
    first, second = control_lines(summary)
    assert re.match(
        r"airborne 0: control: RMSE east \d\.\d\d north \d\.\d\d up \d\.\d\d m; \d+% of 8 within CE90, ", first
    )
    assert second.startswith("airborne 0: control: P4 contradicts the others: test value")


def test_the_report_shows_it(found: ControlResult, tmp_path: Path) -> None:
    page = report_page(Result.read(summary_with(found, tmp_path)))
    assert 'id="control"' in page and "Control was used: the model lies on it" in page and "P0 to P2" in page
    (part,) = control_parts(Result.read(tmp_path / "run").summary)
    assert part.drawing.count("<circle") == 9 and part.drawing.count("stroke-dasharray") == 1
    (tmp_path / "none").mkdir()
    assert 'id="control"' not in report_page(Result.read(summary_with(None, tmp_path / "none")))


def test_hostile_names_stay_text(tmp_path: Path) -> None:
    control = surveyed(SIX[:3])
    points = tuple(replace(one, name=f"{HOSTILE}{k}") for k, one in enumerate(control.points))
    found = examine(Control(points), registered(ERROR), FRAME, PRIOR)
    page = report_page(Result.read(summary_with(found, tmp_path)))
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page


def test_what_was_not_used_says_why(tmp_path: Path) -> None:
    off = {0: np.array([0.0, 30.0, 0.0])}
    found = examine(surveyed(SIX[:1], off=off, use=True), registered(ERROR), FRAME, PRIOR)
    run = summary_with(found, tmp_path)
    lines = control_lines(Result.read(run).summary)
    assert any("control was not used: control and reference differ by" in line for line in lines)
    assert "Not used: control and reference differ by" in report_page(Result.read(run))
