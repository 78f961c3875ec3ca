# SPDX-License-Identifier: Apache-2.0
"""Progress bars, notes and tables on the terminal; plain lines in a pipe."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Table

from skymoor.pipeline.log import LOG
from skymoor.pipeline.words import time_in_words
from skymoor.store._plain import plain
from skymoor.types import Progress

NOTE_S = 20.0  # between two lines of one stage in a pipe


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Rich would exit with status 1; the command line has the status of the signal, as other programs."""
        raise BrokenPipeError


class Screen:
    """Shows progress: bars on a terminal, one line per finished stage elsewhere."""

    def __init__(self, *, plain: bool = False, for_scripts: bool = False) -> None:
        """`plain` for lines in place of bars; `for_scripts` sends all but the JSON of `answer` to stderr."""
        stream = sys.stderr if for_scripts else sys.stdout
        self._console = _Console(file=stream, width=None if stream.isatty() else 160, highlight=False)
        self._for_scripts = for_scripts
        self._tracks: dict[str, Progress] = {}
        self._ended: set[str] = set()
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

    def progress(self, stage: str, done: int, total: int, note: str = "", /) -> None:
        """Progress of any stage, by its name; one that has ended begins anew where it is less than done again."""
        if stage in self._ended and done >= total:
            return
        if stage not in self._tracks or stage in self._ended:
            self._tracks[stage] = self.track(stage)
            self._ended.discard(stage)
        if done >= total:
            self._ended.add(stage)
        self._tracks[stage](done, total, note)

    def note(self, text: str) -> None:
        """One line."""
        self._console.print(text, soft_wrap=True, markup=False)
        LOG.info("%s", text)

    def show(self, table: Table) -> None:
        """A table."""
        self._console.print(table)

    def answer(self, value: object, *, indent: int | None = None) -> None:
        """JSON on stdout, where there are scripts to read it."""
        if self._for_scripts:
            sys.stdout.write(json.dumps(plain(value), ensure_ascii=False, allow_nan=False, indent=indent) + "\n")


@dataclass
class _Lines:
    name: str
    console: Console
    start: float | None = None
    noted: float = 0.0

    def __call__(self, done: int, total: int, note: str = "", /) -> None:
        now = time.monotonic()
        self.start = self.start or now
        if done >= total:
            self.console.print(f"{self.name}: {total} done in {time_in_words(now - self.start)}", markup=False)
        elif note and now - (self.noted or self.start) > NOTE_S:
            self.noted = now
            self.console.print(f"{self.name}: {note}", markup=False)
