# SPDX-License-Identifier: Apache-2.0
"""Progress bars, notes and tables on the terminal; plain lines in a pipe."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Table
from rich.text import Text

from skymoor.evaluate import EvaluationRow
from skymoor.types import Progress

NOTE_S = 20.0  # between two lines of one stage in a pipe


class Screen:
    """Shows progress: bars on a terminal, one line per finished stage elsewhere."""

    def __init__(self, *, plain: bool = False) -> None:
        self._console = Console(width=None if sys.stdout.isatty() else 160, highlight=False)
        self._plain = plain or not self._console.is_terminal
        self._bars = Bars(
            TextColumn("{task.description:>22}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            disable=self._plain,
        )

    def __enter__(self) -> Screen:
        self._bars.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.__exit__(kind, value, trace)

    def track(self, name: str) -> Progress:
        """A progress callback for a stage."""
        if self._plain:
            return _Lines(name, self._console)
        task = self._bars.add_task(name, total=None, note="")

        def update(done: int, total: int, note: str = "", /) -> None:
            self._bars.update(task, completed=done, total=total, note=note)

        return update

    def note(self, text: str) -> None:
        """One line."""
        self._console.print(text, soft_wrap=True, markup=False)

    def show(self, table: Table) -> None:
        """A table."""
        self._console.print(table)


@dataclass
class _Lines:
    name: str
    console: Console
    start: float | None = None
    told: float = 0.0

    def __call__(self, done: int, total: int, note: str = "", /) -> None:
        now = time.monotonic()
        self.start = self.start or now
        if done >= total:
            self.console.print(f"{self.name}: {total} done in {now - self.start:.0f} s", markup=False)
        elif note and now - (self.told or self.start) > NOTE_S:
            self.told = now
            self.console.print(f"{self.name}: {note}", markup=False)


def summary_table(summary: dict[str, Any]) -> Table:
    """One line per component."""
    table = Table(title=Text(summary["site"]))  # Text, because square brackets in a name are no markup
    for heading in ("set", "component", "status", "cameras", "matches", "inliers", "CE90 m", "LE90 m", "remark"):
        table.add_column(heading)
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
                Text(component["reason"] or component["calibration_note"]),
            )
        if not item["components"]:
            table.add_row(item["set"], "-", item["status"], "0", "-", "-", "-", "-", item["reason"])
    return table


def evaluation_table(rows: Sequence[EvaluationRow]) -> Table:
    """The paper's two tables in one: errors in metres of every component.

    abs and its median, horizontal and vertical mean; M-dist of the mean error and the mean per camera; rel (without
    the mean error) and its median; fit: after the best similarity; the standoff; and what was predicted.
    """
    table = Table(title="errors against the truth")
    columns = [
        ("abs", "mean_absolute_m"),
        ("median", "median_absolute_m"),
        ("horiz", "mean_horizontal_m"),
        ("vert", "mean_vertical_m"),
        ("M-dist", "mahalanobis_of_mean"),
        ("mean M", "mean_mahalanobis"),
        ("rel", "mean_relative_m"),
        ("median", "median_relative_m"),
        ("fit", "rmse_procrustes_m"),
        ("standoff", "standoff_m"),
        ("CE90", "predicted_ce90_m"),
        ("LE90", "predicted_le90_m"),
    ]
    for heading in ("set", "no", "status", "cameras", *(heading for heading, _ in columns)):
        table.add_column(heading)
    for row in rows:
        numbers = [_number(getattr(row, name)) for _, name in columns]
        table.add_row(row.set, str(row.component), row.status, str(row.n_cameras), *numbers)
    return table


def accuracy_table(rows: Sequence[EvaluationRow]) -> Table:
    """The error split, and whether what was predicted holds: metres, and shares of cameras.

    The bias is the mean error, which holds the reference's own; CE90 and LE90 as predicted and the share of cameras
    within; and the predicted accuracy without the reference's error, beside what was found without the bias.
    """
    table = Table(title="what was predicted, and what holds")
    columns = [
        ("bias E", "bias_east_m"),
        ("N", "bias_north_m"),
        ("up", "bias_up_m"),
        ("CE90", "predicted_ce90_m"),
        ("within", "share_within_ce90"),
        ("LE90", "predicted_le90_m"),
        ("within", "share_within_le90"),
        ("relative CE90", "predicted_relative_ce90_m"),
        ("LE90", "predicted_relative_le90_m"),
        ("rel", "mean_relative_m"),
    ]
    for heading in ("set", "no", *(heading for heading, _ in columns)):
        table.add_column(heading)
    for row in rows:
        numbers = []
        for _, name in columns:
            value = getattr(row, name)
            numbers.append(f"{value:.0%}" if name.startswith("share") and value is not None else _number(value))
        table.add_row(row.set, str(row.component), *numbers)
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
