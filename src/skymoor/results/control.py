# SPDX-License-Identifier: Apache-2.0
"""What control says of each component: its part of summary.json, and control.csv."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from skymoor.control import ControlResult, ControlRow

CONTROL_COLUMNS = (
    *("set", "component", "name", "kind", "use", "photos", "east_m", "north_m", "up_m"),
    *("sigma_east_m", "sigma_north_m", "sigma_up_m", "length_m", "sigma_length_m", "ratio", "ratio_sigma", "distance"),
    *("inside_ellipsoid", "inside_ce90", "inside_le90", "test", "limit"),
    *("after_east_m", "after_north_m", "after_up_m", "after_length_m", "reason"),
)
AXES = ("east", "north", "up")


def control_summary(found: ControlResult | None) -> dict[str, Any] | None:
    """The part of a component; None where it has no control."""
    if found is None:
        return None
    adjusted = found.adjusted
    return {
        "used": found.used,
        "reason": found.reason,
        "notes": list(found.notes),
        "correction": None if adjusted is None else adjusted.correction,
        "disagreement_m": None if adjusted is None else adjusted.disagreement_m,
        "totals": asdict(found.totals),
        "points": [asdict(row) for row in found.rows],
    }


def control_table(components: Sequence[tuple[str, int, ControlResult | None]]) -> list[dict[str, object]]:
    """Lines of control.csv; `components` are set, number and control."""
    return [
        {"set": name, "component": number, **_cells(row)}
        for name, number, found in components
        if found is not None
        for row in found.rows
    ]


def _cells(row: ControlRow) -> dict[str, object]:
    numbers = {
        **_vector("{}_m", row.residual_m),
        **_vector("sigma_{}_m", row.sigma_m),
        **_vector("after_{}_m", row.after_m),
    }
    plain = {
        name: getattr(row, name) for name in ("name", "kind", "use", "distance", "test", "limit", "ratio", "reason")
    }
    plain |= {name: getattr(row, name) for name in ("inside_ellipsoid", "inside_ce90", "inside_le90", "ratio_sigma")}
    cells = dict.fromkeys(CONTROL_COLUMNS[2:]) | plain | {"photos": row.n_photos} | numbers
    return {name: "" if value is None else value for name, value in cells.items()}


def _vector(name: str, values: Sequence[float | None]) -> dict[str, float | None]:
    axes = ("length",) if len(values) == 1 else AXES
    return {name.format(axis): value for axis, value in zip(axes, values, strict=False)}


def controlled_components(summary: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Name and control of every component of summary.json that has some."""
    for one in summary["sets"]:
        for part in one["components"]:
            if part.get("control"):
                yield f"{one['set']} {part['component']}", part["control"]
