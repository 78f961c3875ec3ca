# SPDX-License-Identifier: Apache-2.0
"""What the screen shows of a finished run of photos."""

from __future__ import annotations

from skymoor.cli.progress import Screen
from skymoor.cli.tables import control_lines, control_tables, remarks, summary_table
from skymoor.results.changes import changes_words
from skymoor.results.read import Result
from skymoor.results.report.page import has_question
from skymoor.results.report.words import person_words
from skymoor.results.report.write import PAGE


def show_result(screen: Screen, result: Result) -> None:
    """The table, what is to be known of each component, who helped, and where everything is."""
    summary, out = result.summary, result.folder
    for table in (summary_table(summary), *control_tables(summary)):
        screen.show(table)
    for line in filter(None, [person_words(summary), *remarks(summary), *control_lines(summary), changes_words(out)]):
        screen.note(line)
    if has_question(result):
        screen.note(f"if you know where the site lies: skymoor ask {out}")
    screen.note(f"results in {out}; to read: {out / PAGE}")
    answer = {"out": out.resolve(), "site": summary["site"], "sets": summary["sets"]}
    screen.answer({**answer, "person": summary["person"]} if summary.get("person") else answer)
