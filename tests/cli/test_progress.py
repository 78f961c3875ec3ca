# SPDX-License-Identifier: Apache-2.0
"""What long work says in a pipe, and on a terminal."""

from __future__ import annotations

import io
import logging
import sys
import warnings
from pathlib import Path

import pytest

from skymoor.cli import progress as screen
from skymoor.cli.main import _parse, main
from skymoor.cli.progress import Screen
from skymoor.cli.usage import parsed
from skymoor.pipeline.estimate import Step
from skymoor.pipeline.log import LOG, logged, quiet_libraries


def test_long_work_says_now_and_then_how_it_goes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    with Screen(plain=True) as shown:
        progress = shown.track("model")
        for step in range(10):
            progress(step, 10, f"step {step}")
            now[0] += screen.NOTE_S / 4
        progress(10, 10)
    lines = capsys.readouterr().out.splitlines()
    # Of ten notes a quarter of the interval apart one in five is due: the first is not yet.
    assert [line.strip() for line in lines] == ["model: step 5", "model: 10 done in 50 s"]


def test_quick_work_says_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with Screen(plain=True) as shown:
        progress = shown.track("depth")
        progress(1, 2)
        progress(2, 2)
    assert capsys.readouterr().out.splitlines() == ["depth: 2 done in 0 s"]


class Terminal(io.StringIO):
    """What a terminal is sent."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_the_run_and_its_step(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, now = Terminal(), [100.0]
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    steps = [Step("photos", "", 10.0, 0.0), Step("reconstruct", "", 90.0, 0.0)]
    with Screen() as shown:
        shown.begin(steps)
        shown.progress("photos", 0, 1)
        now[0] += 10.0
        shown.progress("photos", 26, 26)
        shown.progress("airborne: reconstruction", 0, 1)
        bars = shown._bars
        assert bars is not None

        def words() -> list[str]:
            bars.get_renderables()
            return [str(task.fields["words"]) for task in bars.tasks]

        now[0] += 5.0
        assert words() == ["10 %  elapsed 0:15, left 2 min", "elapsed 0:05"]
        assert bars.tasks[-1].total is None  # it pulses, and nothing is said of 0/?
        now[0] += 40.0
        shown.progress("airborne: reconstruction", 50, 100, "mapping")
        assert words() == ["55 %  elapsed 0:55, left 45 s", "50 of 100  elapsed 0:45  mapping"]
        assert [task.description for task in bars.tasks] == ["all steps", "airborne: reconstruction"]
    assert "photos: 26 done in 10 s" in terminal.getvalue()
    assert "0/?" not in terminal.getvalue()


def test_the_log_is_shown_on_request_and_libraries_are_not_heard_without(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def tell() -> None:
        LOG.info("a step begins")
        logging.getLogger("rasterio").warning("a tag is odd")
        logging.getLogger("rasterio").info("opened")
        warnings.showwarning(UserWarning("old"), UserWarning, "library.py", 7)

    with quiet_libraries(), Screen(plain=True), logged(tmp_path / "run.log"):
        tell()
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", "")
    lines = (tmp_path / "run.log").read_text().splitlines()
    assert [line.partition(",")[2][4:] for line in lines[1:-1]] == [
        "INFO a step begins",
        "WARNING a tag is odd",
        "WARNING UserWarning: old (library.py, line 7)",
    ]
    with quiet_libraries(), Screen(plain=True, verbose=True) as shown:
        tell()
        shown.note("said once")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" ", 1)[1] for line in lines[:3]] == [
        "a step begins",
        "a tag is odd",
        "UserWarning: old (library.py, line 7)",
    ]
    assert lines[3:] == ["said once"]


def test_short_forms_are_those_of_the_long_ones(tmp_path: Path) -> None:
    chosen = parsed(_parse, ["run", str(tmp_path), "-q", "-o", str(tmp_path / "out"), "-v"])
    assert (chosen.quiet, chosen.out, chosen.verbose) == (True, tmp_path / "out", True)
    for command in ("export x --to kml -o y -q", "simulate -o y -v", "demo -o y -q", "register m --ortho o -o y -v"):
        assert str(parsed(_parse, command.split()).out) == "y"
    assert main(["run", "-ov"]) == 2
