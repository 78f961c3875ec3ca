# SPDX-License-Identifier: Apache-2.0
"""Control in the report: residuals as a table, as arrows in plan, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from skymoor.results.control import controlled_components
from skymoor.results.report import words

SIDE, LONGEST = 320, 0.2  # of the drawing, and the longest arrow as a part of it
INSIDE = {True: "inside", False: "outside", None: words.NONE}


@dataclass(frozen=True)
class ControlPart:
    """The control of one component: name, verdict, rows of texts, notes and a drawing."""

    name: str
    verdict: str
    rows: list[dict[str, Any]]
    notes: list[str]
    drawing: Markup


def control_parts(summary: Mapping[str, Any]) -> list[ControlPart]:
    """Of every component that has some."""
    return [
        ControlPart(
            name, _verdict(found), [_row(one) for one in found["points"]], _notes(found), _arrows(found["points"])
        )
        for name, found in controlled_components(summary)
    ]


def _verdict(found: Mapping[str, Any]) -> str:
    totals, used = found["totals"], "used: the model lies on it" if found["used"] else "compared only"
    if not totals["n"]:
        return f"Control was {used}."
    rmse = ", ".join(words.number(value) for value in totals["rmse_m"])
    mean = ", ".join(words.number(value) for value in totals["mean_m"])
    text = (
        f"Control was {used}. Before that, the residuals of {totals['n']} positions have an RMSE of {rmse} m and a "
        f"mean of {mean} m east, north and up; {words.share(totals['inside_ce90'])} are within the predicted CE90"
    )
    if totals["n_with_height"]:
        text += f", and {words.share(totals['inside_le90'])} of {totals['n_with_height']} within LE90"
    return f"{text}; 90 % are expected."


def _notes(found: Mapping[str, Any]) -> list[str]:
    return [*found["notes"], *([f"Not used: {found['reason']}."] if found["reason"] else [])]


def _row(one: Mapping[str, Any]) -> dict[str, Any]:
    at_bar = len(one["residual_m"]) == 1
    residual = one["residual_m"] if at_bar else one["residual_m"] or [None] * 3
    pairs = zip(residual, one["sigma_m"] or [None] * len(residual), strict=True)
    texts = [
        f"{words.number(value, 3)} ± {words.number(sigma, 3)}" if value is not None else words.NONE
        for value, sigma in pairs
    ]
    after = ", ".join(words.number(value, 3) for value in one["after_m"]) or words.NONE
    return {
        "name": one["name"],
        "kind": one["kind"],
        "use": one["use"],
        "photos": one["n_photos"],
        "residuals": [*texts, *([words.NONE] * (3 - len(texts)))],
        "distance": words.number(one["distance"], 1),
        "inside": [INSIDE[one[key]] for key in ("inside_ce90", "inside_le90")],
        "after": after,
        "reason": one["reason"],
    }


def _arrows(rows: Sequence[Mapping[str, Any]]) -> Markup:
    """Residuals in plan, from where the survey has a point to where the model has it, enlarged."""
    shown = [row for row in rows if len(row["residual_m"]) > 1 and row["known_m"]]
    if not shown:
        return Markup("")
    start = np.array([row["known_m"][:2] for row in shown], dtype=np.float64)
    arrow = np.array([row["residual_m"][:2] for row in shown], dtype=np.float64)
    extent = max(float(np.ptp(start, axis=0).max()), 1.0)
    longest = max(float(np.linalg.norm(arrow, axis=1).max()), 1e-9)
    times = float(f"{LONGEST * extent / longest:.1g}")
    scale = SIDE * (1 - 2 * LONGEST) / extent
    middle = (start.max(axis=0) + start.min(axis=0)) / 2
    lines = []
    for row, a, b in zip(shown, (start - middle) * scale, (start + times * arrow - middle) * scale, strict=True):
        x0, y0, x1, y1 = (SIDE / 2 + a[0], SIDE / 2 - a[1], SIDE / 2 + b[0], SIDE / 2 - b[1])
        lines.append(
            Markup(
                '<circle cx="{x0}" cy="{y0}" r="3"/><path d="M{x0} {y0}L{x1} {y1}"{dash}/>'
                '<text x="{tx}" y="{ty}">{name}</text>'
            ).format(
                **{key: f"{value:.1f}" for key, value in (("x0", x0), ("y0", y0), ("x1", x1), ("y1", y1))},
                dash=Markup(' stroke-dasharray="4 3"') if row["use"] == "wrong" else "",
                tx=f"{x0 + 5:.1f}",
                ty=f"{y0 - 5:.1f}",
                name=row["name"].rsplit("/", 1)[-1],
            )
        )
    return Markup(
        '<figure class="arrows"><svg viewBox="0 0 {side} {side}" role="img" aria-label="Residuals of control in plan, '
        'north up">{lines}</svg><figcaption>From the survey to the model, enlarged {times} times; dashed where the '
        "others contradict it.</figcaption></figure>"
    ).format(side=SIDE, lines=Markup("").join(lines), times=f"{times:g}")
