# SPDX-License-Identifier: Apache-2.0
"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from skymoor.batch.sites import Outcome
from skymoor.bench import KindRow
from skymoor.cli.doctor import Check
from skymoor.engines.proj_grids import DatumGrids
from skymoor.engines.weights import Weights
from skymoor.evaluate import EvaluationRow
from skymoor.pipeline.estimate import Step
from skymoor.pipeline.words import size_in_words, time_in_words
from skymoor.registration.criteria import remedy_of
from skymoor.results.control import AXES, controlled_components

MIB = 2**20


def summary_table(summary: dict[str, Any]) -> Table:
    """One line per component."""
    table = Table(title=Text(summary["site"]))  # Text, because square brackets in a name are no markup
    for heading in (
        "set",
        "no",
        "status",
        "cameras",
        "matches",
        "inliers",
        "CE90 m",
        "LE90 m",
        "heights",
    ):
        table.add_column(heading, no_wrap=heading == "status", overflow="fold")
    for item in summary["sets"]:
        for component in item["components"]:
            table.add_row(
                item["set"],
                str(component["component"]),
                component["status"],
                str(component["n_cameras"]),
                str(component["n_matches"]),
                f"{component['inlier_ratio']:.0%}",
                _number(component.get("predicted_ce90_m")),
                _number(component.get("predicted_le90_m")),
                component.get("heights") or "-",
            )
        if not item["components"]:
            table.add_row(item["set"], "-", item["status"], "0", "-", "-", "-", "-", "-")
    return table


def control_tables(summary: dict[str, Any]) -> list[Table]:
    """The residuals of control of each component that has some: model minus known, in metres."""
    tables = []
    for name, found in controlled_components(summary):
        table = Table(title=Text(f"{name}: control {'that was used' if found['used'] else 'as a check'}, metres"))
        for heading in ("name", "kind", "use", "photos", "east", "north", "up", "CE90", "LE90", "after", "reason"):
            table.add_column(heading)
        for row in found["points"]:
            at_bar = len(row["residual_m"]) == 1
            values = (
                [f"{row['residual_m'][0]:+.3f} of length", "", ""]
                if at_bar
                else list(map(_signed, _axes(row, "residual_m")))
            )
            after = ", ".join(map(_signed, row["after_m"]))
            inside = [{True: "inside", False: "outside", None: "-"}[row[key]] for key in ("inside_ce90", "inside_le90")]
            cells = (row["kind"], row["use"], str(row["n_photos"]), *values, *inside, after or "-", row["reason"])
            table.add_row(Text(row["name"]), *cells)
        tables.append(table)
    return tables


def control_lines(summary: dict[str, Any]) -> list[str]:
    """What a person must know of it: RMSE and coverage, what is wrong, and why it was not used."""
    lines = []
    for name, found in controlled_components(summary):
        totals = found["totals"]
        if totals["n"]:
            rmse = " ".join(f"{axis} {_number(value)}" for axis, value in zip(AXES, totals["rmse_m"], strict=True))
            inside = f"{totals['inside_ce90']:.0%} of {totals['n']} within CE90"
            if totals["n_with_height"]:
                inside += f", {totals['inside_le90']:.0%} of {totals['n_with_height']} within LE90"
            lines.append(f"{name}: control: RMSE {rmse} m; {inside}")
        lines += [f"{name}: control: {note}" for note in found["notes"]]
        lines += [f"{name}: control was not used: {found['reason']}"] if found["reason"] else []
    return lines


def _axes(row: dict[str, Any], key: str) -> list[float | None]:
    return row[key] or [None] * len(AXES)


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.3f}"


def _remark(component: dict[str, Any]) -> str:
    """What a person must know of the heights of a registered component."""
    height = component.get("height_verdict") or {}
    return "; ".join(text for text in (height.get("reason", ""), component["calibration_note"]) if text)


def outcomes_table(outcomes: Sequence[Outcome]) -> Table:
    """One line per site of a batch."""
    table = Table(title="sites")
    for heading in ("site", "status", "components", "photos", "CE90 m", "time"):
        table.add_column(heading)
    for one in sorted(outcomes, key=lambda one: one.name):
        counts = (f"{one.registered} of {one.components}", f"{one.placed} of {one.photos}")
        table.add_row(Text(one.name), one.verdict, *counts, _number(one.ce90_m), time_in_words(one.seconds))
    return table


def remarks(summary: dict[str, Any]) -> list[str]:
    """Why each component was refused with its remedy, and what else is to be known of it; a line for each.

    Below the table: in a column of it, sentences would take the room of the figures.
    """
    lines, person = [], (summary.get("person") or {}).get("component")
    for item in summary["sets"]:
        for part in item["components"]:
            told = [part["reason"] or _remark(part), remedy_of(part)]
            told += ["a person helped"] if person == f"{item['set']}_{part['component']}" else []
            text = ". ".join(one.rstrip(".") for one in told if one)
            lines += [f"{item['set']} {part['component']}: {text}"] if text else []
        if not item["components"] and item["reason"]:
            lines.append(f"{item['set']}: {item['reason']}")
    return lines


EVALUATED = (
    ("cameras with a known position", "n_truth", ""),
    ("mean distance (abs)", "mean_absolute_m", "m"),
    ("median distance", "median_absolute_m", "m"),
    ("mean horizontal error", "mean_horizontal_m", "m"),
    ("mean vertical error", "mean_vertical_m", "m"),
    ("mean error (bias): east", "bias_east_m", "m"),
    ("  north", "bias_north_m", "m"),
    ("  up", "bias_up_m", "m"),
    ("mean distance without the bias (rel)", "mean_relative_m", "m"),
    ("median distance without the bias", "median_relative_m", "m"),
    ("RMSE after the best similarity (fit)", "rmse_procrustes_m", "m"),
    ("bias over the reference's sigma (M-dist)", "mahalanobis_of_mean", ""),
    ("mean over the cameras (mean M-dist)", "mean_mahalanobis", ""),
    ("predicted CE90", "predicted_ce90_m", "m"),
    ("  cameras within", "share_within_ce90", "%"),
    ("predicted LE90", "predicted_le90_m", "m"),
    ("  cameras within", "share_within_le90", "%"),
    ("predicted CE90 without the reference's error", "predicted_relative_ce90_m", "m"),
    ("predicted LE90 without the reference's error", "predicted_relative_le90_m", "m"),
    ("distance to the scene (standoff)", "standoff_m", "m"),
)
"""What is compared with the truth, with the paper's short names: words, measure and unit."""


def evaluation_table(rows: Sequence[EvaluationRow]) -> Table:
    """The paper's two tables in one, and whether what was predicted holds: a column for each component.

    A line for each measure has room for its words on every terminal; a line for each component has not.
    """
    table = Table(title="errors against the truth")
    table.add_column("")
    for row in rows:
        table.add_column(Text(f"{row.set} {row.component}"), justify="right")
    if any(row.status != "REGISTERED" for row in rows):
        table.add_row("status", *(row.status for row in rows))
    for words, name, unit in EVALUATED:
        values = [getattr(row, name) for row in rows]
        if any(value is not None for value in values):
            table.add_row(words, *(_with_unit(value, unit) for value in values))
    return table


def _with_unit(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    if unit == "%":
        return f"{value:.0%}"
    return str(value) if isinstance(value, int) else f"{_number(value)} {unit}".rstrip()


def bench_table(rows: Sequence[KindRow]) -> Table:
    """One line for each kind of image pairs; errors in pixels of the second image, CPU seconds per pair."""
    table = Table(title="against the labels")
    for heading in ("kind", "pairs", "answers", "within 3 px", "5 px", "10 px", "mean px", "median px", "CPU s"):
        table.add_column(heading)
    for row in rows:
        shares = [f"{n} ({n / row.pairs:.0%})" for n in row.within]
        numbers = map(_number, (row.mean_error_px, row.median_error_px, row.cpu_s))
        table.add_row(row.kind, str(row.pairs), str(row.answers), *shares, *numbers)
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def weights_table(known: Sequence[Weights], folder: Path) -> Table:
    """One line for each engine's weights."""
    table = Table(title=Text(f"pretrained weights; they lie in {folder}"))
    table.add_column("name", no_wrap=True)
    for heading in ("for", "size", "here", "licence: code", "weights", "sha256", "note"):
        table.add_column(heading, overflow="fold")
    for one in known:
        there = one.here(folder)
        digests = [file.sha256 for file in one.files if not file.folder]
        table.add_row(
            one.name,
            one.what_for,
            "?" if one.size_mb is None else size_in_words(one.size_mb * 1e6),
            "yes" if all(there) else "part" if any(there) else "no",
            one.code_licence,
            one.weights_licence,
            "-" if not digests else "known: checked" if all(digests) else "not known: printed after the fetch",
            one.note,
        )
    return table


def grids_table(known: Sequence[DatumGrids], folder: Path) -> Table:
    """One line for each grid of a datum."""
    table = Table(title=Text(f"grids of common datums, of which a reference needs one; PROJ finds them in {folder}"))
    for heading in ("datum", "name", "grid", "here", "valid in"):
        table.add_column(heading, overflow="fold", no_wrap=heading in ("datum", "grid"))
    for datum in known:
        for k, (grid, area) in enumerate(datum.grids):
            code, name = (datum.code, datum.name) if k == 0 else ("", "")
            table.add_row(code, Text(name), grid, "yes" if grid in datum.here else "no", Text(area))
    return table


def checks_table(checks: Sequence[Check]) -> Table:
    """What `skymoor doctor` found."""
    table = Table(title="this machine")
    for heading in ("", "found", "status", "what to do"):
        table.add_column(heading, overflow="fold")
    for check in checks:
        table.add_row(Text(check.name), Text(check.found), check.status, Text(check.remedy))
    return table


def plan_table(steps: Sequence[Step]) -> Table:
    """What a run would do."""
    table = Table(title="what a run would do; times are of two cores, and right to a factor of two")
    for heading in ("step", "what", "about", "memory"):
        table.add_column(heading, justify="right" if heading in ("about", "memory") else "left")
    for step in steps:
        table.add_row(step.name, step.what, time_in_words(step.seconds), size_in_words(step.mib * MIB))
    total, most = sum(step.seconds for step in steps), max(step.mib for step in steps)
    table.add_row("in all", "", time_in_words(total), size_in_words(most * MIB), style="bold")
    return table
