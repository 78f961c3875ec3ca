# SPDX-License-Identifier: Apache-2.0
"""The skymoor command as a process: its arguments, what its lines mean, and its end. Nothing of QGIS is needed here."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from queue import Empty, Queue

COMMAND_SETTING = "SKYMOOR_COMMAND"
DEFAULT_COMMAND = "skymoor"
REGISTERED, WRONG_INPUT, NOT_REGISTERED = 0, 2, 3
PATIENCE_S = 8.0  # skymoor answers within five
POLL_S = 0.2
# Of QGIS' own Python and libraries, which another Python must not load.
NOT_PASSED_ON = ("PYTHONHOME", "PYTHONPATH", "GDAL_DATA", "PROJ_LIB", "PROJ_DATA", "GDAL_DRIVER_PATH")
_ENDED = re.compile(r"^(?P<stage>.+): (?:(?:\d+ )?done in |from the cache$)")


class CommandError(Exception):
    """One line for the user."""


@dataclass(frozen=True)
class Outcome:
    """What a finished run says: whether all is registered, and lines in plain words."""

    registered: bool
    lines: tuple[str, ...]


def found_command(text: str) -> str:
    """The file of the command. Raises `CommandError` with the remedy where there is none."""
    path = shutil.which(str(Path(text.strip() or DEFAULT_COMMAND).expanduser()))
    if path is None:
        raise CommandError(
            f"{text}: there is no such command; install skymoor, and name its file in Settings > Options > "
            "Processing > Providers > skymoor"
        )
    return path


def arguments_of(
    command: str,
    *,
    out: str,
    ortho: str,
    dsm: str = "",
    vertical_datum: str = "",
    ce90: float | None = None,
    le90: float | None = None,
    airborne: Sequence[str] = (),
    ground: Sequence[str] = (),
    model: Sequence[str] = (),
) -> list[str]:
    """The words of `skymoor run`, or of `skymoor register` where a model is given.

    Raises `CommandError` where they cannot be right; skymoor itself checks the rest.
    """
    if not model and not airborne and not ground:
        raise CommandError("name a folder of photos: airborne, ground, or both")
    if (ce90 is None) != (le90 is None) and dsm:
        raise CommandError("give both CE90 and LE90 of the reference, or neither: its accuracy is unknown then")
    words = [command, "register", *model] if model else [command, "run"]
    for name, folders in (("--airborne", airborne), ("--ground", ground)):
        for folder in folders:
            words += [name, folder]
    words += ["--ortho", ortho]
    for name, value in (("--dsm", dsm), ("--vertical-datum", vertical_datum)):
        words += [name, value] if value else []
    if ce90 is None:
        words += ["--accuracy", "unknown"]
    else:
        words += ["--ce90", f"{ce90:g}"]
        words += [] if le90 is None or not dsm else ["--le90", f"{le90:g}"]
    return [*words, "--out", out, "--quiet"]


def environment(own: Mapping[str, str]) -> dict[str, str]:
    """That of the process: without what leads to QGIS' Python, and with output line by line."""
    return {name: value for name, value in own.items() if name not in NOT_PASSED_ON} | {"PYTHONUNBUFFERED": "1"}


def ended_stage(line: str) -> str | None:
    """The name of the stage that a line of skymoor says is done; None for other lines."""
    found = _ENDED.match(line)
    return found["stage"] if found else None


def share_done(stages: int) -> float:
    """Percent to show after so many stages: how many there will be is not known, and 100 is for the end."""
    return 95.0 * (1.0 - 0.92**stages)


def run(words: Sequence[str], heard: Callable[[str], None], cancelled: Callable[[], bool]) -> int | None:
    """Run the command, hand on each line, and return its exit status; None where it was cancelled.

    A cancelled process is asked to end by SIGTERM, and killed with its children where it does not.
    """
    group = {"start_new_session": True} if os.name == "posix" else {}
    process = subprocess.Popen(
        list(words),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        errors="replace",
        env=environment(os.environ),
        **group,
    )
    lines: Queue[str] = Queue()
    reader = threading.Thread(target=_read, args=(process, lines), daemon=True)
    reader.start()
    try:
        while process.poll() is None or reader.is_alive() or not lines.empty():
            if cancelled():
                return None
            with suppress(Empty):
                heard(lines.get(timeout=POLL_S))
        return process.returncode
    finally:
        _end(process)


def _read(process: subprocess.Popen[str], lines: Queue[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line.rstrip())
    process.stdout.close()


def _end(process: subprocess.Popen[str]) -> None:
    """Where it still runs: first asked, then killed."""
    if process.poll() is not None:
        return
    process.terminate()
    with suppress(subprocess.TimeoutExpired):
        process.wait(PATIENCE_S)
        return
    if os.name == "posix":
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def outcome(status: int, last: Sequence[str], out: Path) -> Outcome:
    """What the exit status and summary.json mean, in plain words.

    Raises `CommandError` where skymoor was given wrong input, or failed; the line is its own.
    """
    if status not in (REGISTERED, NOT_REGISTERED):
        said = [line.removeprefix("skymoor: ") for line in last if line.startswith("skymoor: ")]
        told = said[-1] if said else next((line for line in reversed(last) if line), "it said nothing")
        words = "the input is not accepted" if status == WRONG_INPUT else f"skymoor failed with exit status {status}"
        raise CommandError(f"{words}: {told}")
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
        lines = tuple(_lines(summary))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CommandError(f"{out / 'summary.json'}: cannot be read ({error}); run it again") from error
    return Outcome(status == REGISTERED, lines)


def _lines(summary: Mapping[str, object]) -> list[str]:
    """One for each component, and one for each set of photos without any."""
    told = []
    for one in summary["sets"]:  # type: ignore[attr-defined]
        for part in one["components"]:
            name = f"{one['set']}_{part['component']}"
            if part["status"] == "REGISTERED":
                told.append(f"{name}: registered, {_accuracy(part)}")
            else:
                told.append(
                    f"{name}: not registered, and no position is written: {part['reason'] or 'no reason given'}"
                )
        if not one["components"]:
            told.append(f"{one['set']}: not registered: {one.get('reason') or 'no reason given'}")
    return told


def _accuracy(part: Mapping[str, object]) -> str:
    known = [(name, part.get(f"predicted_{name.lower()}_m")) for name in ("CE90", "LE90")]
    words = ", ".join(f"{name} {value:.1f} m" for name, value in known if isinstance(value, Real))
    return words or "accuracy on Earth unknown, as that of the reference"
