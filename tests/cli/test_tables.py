# SPDX-License-Identifier: Apache-2.0
"""Tables that a narrow terminal can show whole, and the sentences below them."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from skymoor.cli.tables import EVALUATED, evaluation_table, remarks, summary_table
from skymoor.evaluate import EvaluationRow

REASON = "match score 252.4 is below the minimum of 1000"


def shown(table: Table, width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table)
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def component(index: int, **facts: Any) -> dict[str, Any]:
    whole = {"component": index, "status": "REGISTERED", "reason": "", "n_cameras": 26, "n_matches": 4123}
    return whole | {"inlier_ratio": 0.98, "calibration_note": "", "criteria": []} | facts


def summary(*components: dict[str, Any]) -> dict[str, Any]:
    return {"site": "office park", "sets": [{"set": "airborne", "components": list(components)}]}


def test_the_status_is_whole_however_long_the_reason() -> None:
    found = summary(component(0, status="NOT_REGISTERED", reason=REASON), component(1))
    for width in (80, 100):
        table = shown(summary_table(found), width)
        assert "NOT_REGISTERED" in table and "…" not in table and "minimum" not in table
    (line,) = remarks(found)
    assert line.startswith(f"airborne 0: {REASON}")


def test_what_is_registered_says_what_is_to_be_known() -> None:
    found = summary(component(0, calibration_note="the focal length is not determined."), component(1))
    assert remarks(found) == ["airborne 0: the focal length is not determined"]
    helped = summary(component(0)) | {"person": {"component": "airborne_0"}}
    assert remarks(helped) == ["airborne 0: a person helped"]
    lost = {"site": "s", "sets": [{"set": "ground0", "status": "NOT_REGISTERED", "components": [], "reason": "no"}]}
    assert remarks(lost) == ["ground0: no"] and "NOT_REGISTERED" in shown(summary_table(lost))


@pytest.mark.parametrize("width", [80, 110])
def test_errors_have_words_and_units_on_a_narrow_terminal(width: int) -> None:
    numbers = {name: 1.25 for _, name, _ in EVALUATED if name != "n_truth"}
    rows = [
        EvaluationRow("airborne", 0, "REGISTERED", 26, 26, **{**numbers, "share_within_ce90": 0.95}),  # type: ignore[arg-type]
        EvaluationRow("ground0", 0, "NOT_REGISTERED", 12, 12),
    ]
    table = shown(evaluation_table(rows), width)
    assert "…" not in table and "1.25 m" in table and "95%" in table and "NOT_REGISTERED" in table
    assert all(words.strip() in table for words, _, _ in EVALUATED)
    unknown = shown(evaluation_table(rows[1:]), width)
    assert "M-dist" not in unknown  # nothing is known of it, so nothing is said
