# SPDX-License-Identifier: Apache-2.0
"""The sites of a batch, and what came of each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skymoor.batch.remote import Address
from skymoor.engines.regular import regular
from skymoor.errors import InputError
from skymoor.pipeline.option_parser import nearest
from skymoor.pipeline.stopping import StopAfter
from skymoor.results.report.write import PAGE

SITE = "site.toml"
LOG = "batch.log"
REGISTERED, FAILED, BAD_INPUT, NOT_REGISTERED = 0, 1, 2, 3  # as `skymoor run` ends


@dataclass(frozen=True)
class SiteTask:
    """One site: its name in the batch, its site.toml, and the folder of its results.

    `stop_after` is the last step of its run; None for all.
    """

    name: str
    toml: Path
    out: Path | Address
    stop_after: StopAfter | None = None


@dataclass(frozen=True)
class Outcome:
    """How the run of a site ended.

    Attributes:
        name, out: of the task.
        exit_status: of `skymoor run`; negative for the signal that ended it.
        seconds: of wall time.
        components, registered: of all sets.
        photos, placed: likewise.
        ce90_m: of the registered components, the largest; None without any.
        message: why it failed, or is not registered; empty where all is well.
        host: on which machine.
        stopped_after: the step after which it ended, as asked; None where it was to be a whole run.
        report: whether its folder has a report of it.
    """

    name: str
    out: Path | Address
    exit_status: int
    seconds: float
    components: int = 0
    registered: int = 0
    photos: int = 0
    placed: int = 0
    ce90_m: float | None = None
    message: str = ""
    host: str = ""
    stopped_after: StopAfter | None = None
    report: bool = False

    @property
    def verdict(self) -> str:
        """REGISTERED, NOT_REGISTERED, STOPPED (as asked), BAD_INPUT or FAILED."""
        if self.stopped_after:
            return "STOPPED"
        words = {REGISTERED: "REGISTERED", NOT_REGISTERED: "NOT_REGISTERED", BAD_INPUT: "BAD_INPUT"}
        return words.get(self.exit_status, "FAILED")


def find_sites(
    named: Sequence[Path], out: Path | Address, only: Sequence[str] = (), stop_after: StopAfter | None = None
) -> list[SiteTask]:
    """The tasks of site.toml files, of folders that have one, and of folders of such folders; by name.

    Each has a folder of its own in `out`. Raises `InputError` for what is none of these, for a name in `only` that no
    site has, and where nothing is left.
    """
    files = [file for one in named for file in _files_of(one)]
    tasks: dict[str, SiteTask] = {}
    for file in dict.fromkeys(file.resolve() for file in files):
        name = base = file.parent.name if file.name == SITE else file.stem
        twins = 1
        while name in tasks:
            twins += 1
            name = f"{base}-{twins}"
        folder = out / name
        tasks[name] = SiteTask(name, file, folder.resolve() if isinstance(folder, Path) else folder, stop_after)
    for name in only:
        if name not in tasks:
            raise InputError(f"--only {name}: there is no such site; {nearest(name, list(tasks))}")
    return [task for name, task in sorted(tasks.items()) if not only or name in only]


def _files_of(named: Path) -> list[Path]:
    if named.is_file():
        return [named]
    if not named.is_dir():
        raise InputError(f"{named}: there is no such file or folder; name site.toml files, or folders that have them")
    if (named / SITE).is_file():
        return [named / SITE]
    found = sorted(named.glob(f"*/{SITE}"))
    if not found:
        raise InputError(f"{named}: has no {SITE}, nor has a folder in it; name site.toml files or their folders")
    return found


def outcome_of(task: SiteTask, folder: Path, exit_status: int, seconds: float, last_line: str, host: str) -> Outcome:
    """With what the summary in the run's folder says, where it came so far."""
    common = {"name": task.name, "out": task.out, "exit_status": exit_status, "seconds": seconds, "host": host}
    if task.stop_after and exit_status == REGISTERED:
        message = f"after {task.stop_after}, as asked"
        return Outcome(**common, stopped_after=task.stop_after, message=message)  # type: ignore[arg-type]
    common["report"] = (folder / PAGE).is_file()
    if exit_status not in (REGISTERED, NOT_REGISTERED):
        killed = f"ended by signal {-exit_status}; too little memory?" if exit_status < 0 else "an error of skymoor"
        return Outcome(**common, message=last_line or f"{killed}, see {task.out / LOG}")  # type: ignore[arg-type]
    try:
        sets: list[dict[str, Any]] = json.loads(regular(folder / "summary.json").read_text(encoding="utf-8"))["sets"]
        parts = [part for one in sets for part in one["components"]]
        there = [part for part in parts if part["status"] == "REGISTERED"]
        errors = [part["predicted_ce90_m"] for part in there if part.get("predicted_ce90_m") is not None]
        reasons = [one["reason"] for one in (*sets, *parts) if one["status"] != "REGISTERED" and one.get("reason")]
        return Outcome(
            **common,  # type: ignore[arg-type]
            components=len(parts),
            registered=len(there),
            photos=sum(part["n_cameras"] for part in parts),
            placed=sum(part["n_cameras"] for part in there),
            ce90_m=max(errors, default=None),
            message="; ".join(dict.fromkeys(reasons)),
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        return Outcome(**{**common, "exit_status": FAILED}, message=f"summary.json cannot be read: {error}")  # type: ignore[arg-type]


def exit_status_of(outcomes: Sequence[Outcome]) -> int:
    """Of the whole batch: the worst of the sites, an error of ours before bad input before what is not registered."""
    found = {one.exit_status for one in outcomes}
    if found - {REGISTERED, BAD_INPUT, NOT_REGISTERED}:
        return FAILED
    return next((status for status in (BAD_INPUT, NOT_REGISTERED) if status in found), REGISTERED)
