# SPDX-License-Identifier: Apache-2.0
"""Jobs that are killed: they run in processes of their own, forked from one that has loaded what they need."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.engines.colmap import write_colmap
from skymoor.store import Store
from support.blocks import block
from support.plain_stages import doubled, drawn

KILLED = -signal.SIGKILL


def processes() -> ForkServerContext:
    """Where to start them; loading skymoor is paid for once."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["support.interrupted", "skymoor.api"])
    return context


def started(job: Callable[..., object], *arguments: object) -> BaseProcess:
    """A process that does the job."""
    process = processes().Process(target=job, args=arguments)
    process.start()
    return process


def status_of(job: Callable[..., object], *arguments: object, patience_s: float | None = None) -> int | None:
    """How the job ended; it is killed when patience runs out."""
    process = started(job, *arguments)
    process.join(patience_s)
    if process.exitcode is None:
        process.kill()
        process.join()
    return process.exitcode


def work(out: Path) -> None:
    """Three stages, a table, a folder and a picture, as a run writes them."""
    with Store.open(out) as store:
        first = store.stage("first", drawn, 1)
        second = store.stage("second", doubled, first)
        third = store.stage("third", np.repeat, second["x"], 2)
        store.remove("summary.json")
        store.write_csv("cameras.csv", ("image", "x"), [{"image": "a", "x": value} for value in third[:3]])
        store.write_folder("colmap/air_0", lambda folder: [(folder / f"{k}").write_text(str(second)) for k in range(3)])
        store.write_npz("renders/a.npz", x=second["x"])
        store.write_json("summary.json", {"sum": second["sum"]})


def work_until(out: Path, count: int) -> None:
    """The same, killed by the system before it gets to touch the disk for the `count`-th time."""
    left = [count]

    def counting(real: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any, **options: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*arguments, **options)

        return wrapped

    for owner, name in [
        *((os, name) for name in ("fsync", "close", "fdopen")),
        *((Path, name) for name in ("replace", "rename", "chmod", "mkdir", "unlink", "write_text")),
    ]:
        setattr(owner, name, counting(getattr(owner, name)))
    work(out)


def write_model(out: Path) -> None:
    """A COLMAP model, which COLMAP itself writes."""
    component = block("oblique", relief_m=3.0)
    with Store.open(out) as store:
        store.write_folder("colmap/air_0", lambda folder: write_colmap(component, folder))


def with_room_for(job: Callable[[Path], None], out: Path, size: int, answer: Any) -> None:
    """The job on a disk on which no file may grow beyond `size` bytes; `answer` is sent what was raised, or None."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    try:
        job(out)
    except Exception as error:
        answer.send((type(error).__name__, str(error)))
    else:
        answer.send(None)


def run_site(arguments: list[str], temporary: Path) -> None:
    """`skymoor run`, quietly, with the command's exit status. Kills leave COLMAP's files in the folder `temporary`."""
    from skymoor.cli.main import main

    tempfile.tempdir = str(temporary)
    with Path(os.devnull).open("w") as nothing:
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
    os._exit(main(arguments))


def run_site_within(
    arguments: list[str], folder: Path, module: str, function: str, listens: bool, grace_s: float
) -> None:
    """`skymoor run`, which makes the file `folder`/begun when it calls this function of a library.

    Unless it `listens`, the call takes ten minutes in which nothing of Python runs in its thread. What the screen shows
    goes to `folder`/screen, and temporary files to `folder`/temporary. `grace_s` is what a signal leaves the work.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job's children are born deaf to it
    from skymoor.cli import main as command

    command.GRACE_S = grace_s
    (folder / "temporary").mkdir()
    tempfile.tempdir = str(folder / "temporary")
    screen = os.open(folder / "screen", os.O_CREAT | os.O_WRONLY | os.O_TRUNC | os.O_APPEND)
    os.dup2(screen, 1)
    os.dup2(screen, 2)
    owner = import_module(module)
    real, sleep = getattr(owner, function), ctypes.CDLL(None).sleep

    def call(*given: Any, **options: Any) -> Any:
        (folder / "begun").touch()
        if not listens:
            sleep(600)
        return real(*given, **options)

    setattr(owner, function, call)
    status = command.main(arguments)
    sys.stdout.flush()
    os._exit(status)


def until(there: Path, process: BaseProcess) -> None:
    """Wait for a file that a process will make."""
    while not there.exists():
        assert process.is_alive(), f"ended with {process.exitcode}"
        time.sleep(0.02)
