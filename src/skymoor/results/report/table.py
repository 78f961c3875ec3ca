# SPDX-License-Identifier: Apache-2.0
"""The components of a finished run as one small table in HTML that needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

HEADINGS = ("set", "component", "status", "cameras", "CE90 m", "LE90 m", "heights", "reason")
CELL = "text-align:left;padding:0.2em 0.8em"


def summary_html(summary: Mapping[str, Any]) -> str:
    """One line for each component of summary.json, and one for each set without any."""
    head = "".join(f'<th style="{CELL}">{escape(heading)}</th>' for heading in HEADINGS)
    body = "".join(
        "<tr>" + "".join(f'<td style="{CELL}">{escape(cell)}</td>' for cell in row) + "</tr>" for row in _rows(summary)
    )
    title = escape(str(summary.get("site", "skymoor")))
    return f"<table><caption>{title}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _rows(summary: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for one in summary["sets"]:
        for part in one["components"]:
            accuracy = (_metres(part.get(f"predicted_{name}_m")) for name in ("ce90", "le90"))
            count = str(part.get("n_cameras", "-"))
            heights, reason = str(part.get("heights") or "-"), str(part["reason"])
            yield str(one["set"]), str(part["component"]), str(part["status"]), count, *accuracy, heights, reason
        if not one["components"]:
            yield str(one["set"]), "-", str(one["status"]), "0", "-", "-", "-", str(one.get("reason", ""))


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
