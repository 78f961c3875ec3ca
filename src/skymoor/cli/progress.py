# SPDX-License-Identifier: Apache-2.0
"""Progress bars, notes and tables on the terminal; plain lines in a pipe."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console, RenderableType
from rich.progress import BarColumn, TaskID, TextColumn
from rich.progress import Progress as Bars
from rich.table import Table

from skymoor.cli.interrupt import AT_END
from skymoor.pipeline.log import LOG, heard
from skymoor.pipeline.words import time_in_words
from skymoor.store import FROM_CACHE, plain
from skymoor.types import Progress

if TYPE_CHECKING:
    from skymoor.cli.overall import Overall
    from skymoor.pipeline.estimate import Step

NOTE_S = 20.0  # between two lines of one stage in a pipe
SHOWN = {"shown": True}
"""Marks what is logged and was printed already."""


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Rich would exit with status 1; the command line has the status of the signal, as other programs."""
        raise BrokenPipeError


class Screen:
    """Shows progress: a bar of the run and one of its current step on a terminal, one line per step elsewhere."""

    def __init__(self, *, plain: bool = False, for_scripts: bool = False, verbose: bool = False) -> None:
        """`plain` for lines in place of bars, `for_scripts` sends all but the JSON of `answer` to stderr.

        `verbose` shows what goes to the log as well.
        """
        stream = sys.stderr if for_scripts else sys.stdout
        self._console = _Console(file=stream, width=None if stream.isatty() else 160, highlight=False)
        self._for_scripts, self._verbose = for_scripts, verbose
        self._tracks: dict[str, Progress] = {}
        self._ended: set[str] = set()
        self._bars = None if plain or not self._console.is_terminal else _Bars(self._console)
        self._open = ExitStack()

    def __enter__(self) -> Screen:
        if self._verbose:
            self._open.enter_context(heard(_OnScreen(self._console)))
        if self._bars is not None:
            self._open.enter_context(self._bars)
            AT_END.append(self._bars.stop)  # or the cursor would stay hidden
            self._open.callback(AT_END.remove, self._bars.stop)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def begin(self, steps: Sequence[Step]) -> None:
        """From now on one more bar shows how much of these steps is done, and how long the rest takes."""
        if self._bars is not None:
            self._bars.begin(steps)

    def track(self, name: str) -> Progress:
        """A progress callback for a stage."""
        return _Lines(name, self._console) if self._bars is None else _Current(name, self._bars)

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
        LOG.info("%s", text, extra=SHOWN)

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
            self.console.print(_ended(self.name, total, now - self.start, note), markup=False)
        elif note and now - (self.noted or self.start) > NOTE_S:
            self.noted = now
            self.console.print(f"{self.name}: {note}", markup=False)


@dataclass
class _Current:
    """The step that is shown below the bar of the run; when it ends it becomes a line above."""

    name: str
    bars: _Bars
    start: float | None = None
    done: int = 0
    total: int = 0
    note: str = ""
    reported: float = 0.0

    def __call__(self, done: int, total: int, note: str = "", /) -> None:
        now = time.monotonic()
        self.start = now if self.start is None else self.start
        self.done, self.total, self.note, self.reported = done, total, note or self.note, now
        if done >= total:
            self.bars.hide(self)
            self.bars.console.print(_ended(self.name, total, now - self.start, note), markup=False)
        else:
            self.bars.show(self)

    def words(self, *, alone: bool) -> str:
        """How far it is; `alone`, where no bar of the run says it, also how long the rest takes."""
        now, start = time.monotonic(), self.start or 0.0
        elapsed, counted, left = now - start, "", None
        if self.done > 0:
            counted = f"{self.done} of {self.total}"
            rest = (self.reported - start) * (self.total - self.done) / self.done
            left = max(0.0, rest - (now - self.reported)) if alone else None  # it falls until the next report
        words = (counted, _timed(elapsed, left), self.note)
        return "  ".join(word for word in words if word)


class _Bars(Bars):
    """The bar of the run, where there is a plan, and that of the current step."""

    def __init__(self, console: Console) -> None:
        self._run: tuple[TaskID, Overall] | None = None
        self._step: tuple[TaskID, _Current] | None = None
        columns = (TextColumn("{task.description}", markup=False), BarColumn(bar_width=24))
        super().__init__(*columns, TextColumn("{task.fields[words]}", markup=False), console=console, transient=True)

    def begin(self, steps: Sequence[Step]) -> None:
        """Show the bar of the run."""
        from skymoor.cli.overall import Overall

        self._run = (self.add_task("all steps", total=1.0, words=""), Overall(steps, time.monotonic))

    def show(self, step: _Current) -> None:
        """Make it the current one."""
        self._report(step)
        if self._step is None or self._step[1] is not step:
            self._remove()
            self._step = (self.add_task(step.name, total=None, words=""), step)

    def hide(self, step: _Current) -> None:
        """It has ended."""
        self._report(step)
        if self._step is not None and self._step[1] is step:
            self._remove()

    def get_renderables(self) -> Iterable[RenderableType]:
        """Times go on between two reports, so the words are made when they are shown."""
        if self._run is not None:
            task, overall = self._run
            share = overall.share()
            words = f"{100 * share:.0f} %  {_timed(time.monotonic() - overall.start, overall.left_s())}"
            self.update(task, completed=share, words=words)
        if self._step is not None:
            task, step = self._step
            total = step.total if step.done > 0 else None  # a bar that pulses
            self.update(task, total=total, completed=step.done, words=step.words(alone=self._run is None))
        return super().get_renderables()

    def _report(self, step: _Current) -> None:
        if self._run is not None:
            self._run[1].report(step.name, step.done, step.total, cached=step.note == FROM_CACHE)

    def _remove(self) -> None:
        if self._step is not None:
            task, self._step = self._step[0], None
            self.remove_task(task)


class _OnScreen(logging.Handler):
    """Lines of the log for `--verbose`."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%H:%M:%S"))

    def emit(self, record: logging.LogRecord) -> None:
        if not getattr(record, "shown", False):
            self._console.print(self.format(record), soft_wrap=True, markup=False, style="dim")


def _timed(elapsed_s: float, left_s: float | None) -> str:
    """Such as "elapsed 1:05, left 4 min"."""
    minutes, seconds = divmod(int(elapsed_s), 60)
    left = "" if left_s is None or left_s < 1 else f", left {time_in_words(left_s)}"
    return f"elapsed {minutes}:{seconds:02}{left}"


def _ended(name: str, total: int, seconds: float, note: str) -> str:
    if note == FROM_CACHE:
        return f"{name}: {note}"
    if total == 1:  # counts nothing
        return f"{name}: done in {time_in_words(seconds)}"
    return f"{name}: {total} done in {time_in_words(seconds)}"
