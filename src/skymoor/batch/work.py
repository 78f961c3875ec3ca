# SPDX-License-Identifier: Apache-2.0
"""The run of one site in a process of its own: a crash, or too little memory, ends nothing else."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from skymoor.batch.remote import folder_of
from skymoor.batch.sites import BAD_INPUT, LOG, Outcome, SiteTask, outcome_of
from skymoor.errors import BackendUnavailable, InputError

IN_USE = "another run is writing here"  # what a run says of a folder that is locked
RETRIES, WAIT_S = 6, 5.0  # a lost worker's process ends within seconds
RUNNING: set[subprocess.Popen[bytes]] = set()


def pass_on(number: int) -> None:
    """Send a signal to the processes of all sites, which end as `skymoor run` does."""
    for process in tuple(RUNNING):
        process.send_signal(number)


def run_site(
    task: SiteTask, arguments: Sequence[str] = (), memory_gb: float | None = None, threads: int = 0
) -> Outcome:
    """Run a site and wait for it; what it prints goes to batch.log in its folder.

    The same again continues where it stopped, and costs seconds where it was finished.

    Args:
        task: the site.
        arguments: more of `skymoor run`.
        memory_gb: most memory of the process, in gigabytes; beyond it the site fails, and only it.
        threads: of the libraries that take their number from OMP_NUM_THREADS; 0 leaves it.
    """
    start, host = time.monotonic(), socket.gethostname()
    try:
        if not task.toml.is_file():
            reason = f"{task.toml}: is not seen from {host}; sites and --out must lie where all workers see them"
            return Outcome(task.name, task.out, BAD_INPUT, 0.0, message=reason, host=host)
        command = [sys.executable, "-m", "skymoor.batch.limited", str(memory_gb or 0), "run", str(task.toml)]
        command += ["--quiet", *arguments, *(("--stop-after", task.stop_after) if task.stop_after else ())]
        environment = {**os.environ, **({"OMP_NUM_THREADS": str(threads)} if threads else {})}
        with folder_of(task.out) as folder:
            status, last = _run_in(folder, command, environment)
            outcome = outcome_of(task, folder, status, time.monotonic() - start, last, host)
        return outcome
    except OSError as error:
        message = f"{error.filename or task.out}: {error.strerror or error}"
    except (InputError, BackendUnavailable) as error:  # of the store
        message = str(error)
    return Outcome(task.name, task.out, BAD_INPUT, time.monotonic() - start, message=message, host=host)


def _run_in(folder: Path, command: Sequence[str], environment: dict[str, str]) -> tuple[int, str]:
    """Exit status of a run whose results go to a folder, and the line that says what is wrong with its input."""
    for _ in range(RETRIES):
        status = _ended([*command, "--out", str(folder)], folder / LOG, environment)
        last = _last_line(folder / LOG)
        if status != BAD_INPUT or IN_USE not in last:
            break
        time.sleep(WAIT_S)
    return status, last if status == BAD_INPUT else ""


def _ended(command: Sequence[str], log: Path, environment: dict[str, str]) -> int:
    """The exit status of a command whose output goes to a file."""
    with log.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=environment)
        RUNNING.add(process)
        try:
            return process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            RUNNING.discard(process)


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1].removeprefix("skymoor: ") if lines else ""
