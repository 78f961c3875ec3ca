# SPDX-License-Identifier: Apache-2.0
"""The table of acceptance criteria, and what is read from it."""

from __future__ import annotations

import ast
from dataclasses import asdict
from pathlib import Path

import pytest

import skymoor
from skymoor.pipeline.option_parser import option_names
from skymoor.pipeline.options import Options
from skymoor.registration.criteria import (
    ESTIMATE,
    criteria_of,
    criterion,
    kind_of,
    refusal_of,
    remedy_of,
    with_criteria,
)
from skymoor.registration.criterion_kinds import KINDS
from skymoor.types import Registration

FOUND = Registration(registered=True, reason="", enu_from_level=None, diagnostics={"second_score": 80.0})


def test_numbers_are_written_as_people_write_them() -> None:
    assert all("e+" not in kind.written(123456.7) for kind in KINDS.values())
    assert any(kind.written(1234.5) == "1200" for kind in KINDS.values())


def kinds_in_the_code() -> set[str]:
    """First argument of every call of `criterion`."""
    found = set()
    for file in Path(skymoor.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "criterion":
                first = node.args[0]
                found.add(first.value if isinstance(first, ast.Constant) else ESTIMATE)
    return found


def test_the_table_has_every_kind_that_is_checked_and_no_other() -> None:
    assert kinds_in_the_code() == set(KINDS)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_a_kind_has_meaning_and_remedy(name: str) -> None:
    kind = KINDS[name]
    assert kind.meaning.endswith(".") and kind.remedy.endswith(".") and kind.scopes
    assert kind.limit.startswith(f"at {kind.at} ")
    options = {word.strip(",;:().") for word in f"{kind.limit} {kind.remedy}".split() if word.count(".") > 0}
    assert {word for word in options if "." in word.strip(".") and not word[0].isdigit()} <= set(
        option_names(Options())
    )


@pytest.mark.parametrize(
    ("kind", "value", "passed"),
    [
        ("inliers", 50, True),
        ("inliers", 49, False),
        ("tilt", 50, True),
        ("tilt", 50.1, False),
        ("tilt", float("nan"), False),
    ],
)
def test_a_limit_itself_passes_and_what_is_not_a_number_does_not(kind: str, value: float, passed: bool) -> None:
    assert criterion(kind, value, 50).passed is passed


def test_the_first_that_failed_gives_reason_and_remedy() -> None:
    asked = [criterion("inliers", 90, 50), criterion("competing_score", 90, 104), criterion("cells", 3, 10)]
    found = with_criteria(FOUND, asked)
    assert not found.registered
    assert found.reason == "a competing hypothesis scores 80, the best 90; at least 104 is required"
    component = {"criteria": [asdict(one) for one in found.criteria], "reason": found.reason}
    assert criteria_of(component) == asked
    assert remedy_of(component) == KINDS["competing_score"].remedy
    assert with_criteria(FOUND, asked[:1]).registered and with_criteria(FOUND, asked[:1]).reason == ""


def test_the_reason_of_an_estimator_is_kept() -> None:
    failed = Registration(registered=False, reason="too few matches", enu_from_level=None)
    assert with_criteria(failed, [criterion(ESTIMATE, 0, 1)]).reason == "too few matches"
    assert refusal_of(criterion(ESTIMATE, 0, 1), {}) == KINDS[ESTIMATE].refusal


def test_without_criteria_there_is_no_remedy_but_for_our_own_errors() -> None:
    assert remedy_of({"reason": "the reference is too small"}) == ""
    assert "run.log" in remedy_of({"reason": "internal error (ValueError: x); run.log has the traceback"})
    assert kind_of("of_another_version").name == "of another version"
