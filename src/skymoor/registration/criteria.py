# SPDX-License-Identifier: Apache-2.0
"""Acceptance criteria as data: what a registration was compared with, and reason and remedy of a refusal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from skymoor.registration.criterion_kinds import KINDS, Kind
from skymoor.types import Criterion, Registration

ESTIMATE = "estimate"
REPORT_IT = "This is an error of skymoor: please report it with the run.log of this folder."


def kind_of(name: str) -> Kind:
    """What the table says of a kind; a name alone for one that another version of the program wrote."""
    known = KINDS.get(name)
    return known or Kind(name.replace("_", " "), (), "", name, "", "", "", spec=".4g")


def criterion(kind: str, value: float, limit: float) -> Criterion:
    """A value compared with its limit, which passes itself; a value that is not a number does not pass."""
    passed = value >= limit if KINDS[kind].at == "least" else value <= limit
    return Criterion(kind, float(value), float(limit), bool(passed))


def refusal_of(failed: Criterion, details: Mapping[str, object]) -> str:
    """The reason that a criterion gives; `details` are the diagnostics that its sentence names."""
    kind = KINDS[failed.kind]
    numbers = {"value": kind.written(failed.value), "limit": kind.written(failed.limit)}
    return kind.refusal.format(**{**details, **numbers})


def with_criteria(registration: Registration, criteria: Sequence[Criterion]) -> Registration:
    """The registration, accepted if all criteria passed, else refused with the reason of the first that failed.

    An estimator that found no transform has said why: that is the reason then.
    """
    failed = next((one for one in criteria if not one.passed), None)
    reason = "" if failed is None else refusal_of(failed, registration.diagnostics)
    if failed is not None and failed.kind == ESTIMATE:
        reason = registration.reason or reason
    return replace(registration, registered=failed is None, reason=reason, criteria=tuple(criteria))


def criteria_of(component: Mapping[str, Any]) -> list[Criterion]:
    """The criteria of a component of summary.json; none where the run wrote none."""
    return [
        Criterion(one["kind"], _number(one["value"]), _number(one["limit"]), one["passed"])
        for one in component.get("criteria") or ()
    ]


def remedy_of(component: Mapping[str, Any]) -> str:
    """What helps a component of summary.json that was refused; empty where none is known or it was accepted."""
    failed = next((one for one in criteria_of(component) if not one.passed), None)
    if failed is not None:
        return kind_of(failed.kind).remedy
    return REPORT_IT if "internal error" in str(component.get("reason")) else ""


def _number(value: float | None) -> float:
    """JSON has null for what is not a number."""
    return float("nan") if value is None else value
