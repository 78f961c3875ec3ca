# SPDX-License-Identifier: Apache-2.0
"""Ctrl+C is answered at once and ends the work within seconds, also inside a library.

Python hears signals between two instructions of its main thread, and a call into COLMAP may take minutes. So the work
is done by a second thread while the main thread waits: it answers, asks the work to end, and ends the process where it
does not.
"""

from __future__ import annotations

import ctypes
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Generic, NoReturn, TypeVar

from skymoor.engines.temporary import remove_temporary

T = TypeVar("T")

LOG = logging.getLogger("skymoor")
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU") if hasattr(signal, name))
GRACE_S = 3.0  # for the work to end by itself
POLL_S = 0.1
SAME_S = 0.5  # a second signal within this time is the same one: the terminal's, and a parent's that passes it on
STOPPING = "stopping after this step (press again to stop now)"
STOPPED = "skymoor: stopped; the same command continues from here"
CPU_LIMIT = getattr(signal, "SIGXCPU", None)
OUT_OF_TIME = "skymoor: the limit of CPU time (ulimit -t) is reached; the same command continues from here"
AT_STOP: list[Callable[[int], object]] = []
"""Called with the number of the first signal, such as to pass it on to other processes."""
AT_END: list[Callable[[], object]] = []
"""Called before the process ends by a signal, such as to give the terminal back; once more does no harm."""


class Stopped(KeyboardInterrupt):
    """The work was ended by a signal; `status` is what a shell reports then, and `line` what is told."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.status, self.line = 128 + number, _last_line(number)


def _last_line(number: int) -> str:
    return OUT_OF_TIME if number == CPU_LIMIT else STOPPED


@contextmanager
def cpu_limit_told() -> Iterator[None]:
    """Raise `Stopped` where the limit of CPU time is reached outside of `interruptible`, in place of an end without a
    word, while the block lasts."""

    def stop(number: int, _: FrameType | None) -> NoReturn:
        raise Stopped(number)

    if CPU_LIMIT is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(CPU_LIMIT, stop)
    try:
        yield
    finally:
        signal.signal(CPU_LIMIT, before)


def interruptible(work: Callable[[], T], *, told: str = STOPPING, grace_s: float = GRACE_S) -> T:
    """What `work` returns or raises; `KeyboardInterrupt` is raised in it when the process is to end.

    `told` is the answer to the first signal. Raises `Stopped` where the work ended by it. Where it does not end within
    `grace_s`, or at a second signal, the process ends. Outside of the main thread, which alone hears signals, it is
    just called.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    return _Work(work, told, grace_s).wait()


class _Work(Generic[T]):
    def __init__(self, work: Callable[[], T], told: str, grace_s: float) -> None:
        self._work, self._told, self._grace_s = work, told, grace_s
        self._thread = threading.Thread(target=self._do, name="work", daemon=True)
        self._results: list[T] = []
        self._error: BaseException | None = None
        self._number = 0
        self._heard: list[float] = []

    def _do(self) -> None:
        try:
            self._results.append(self._work())
        except BaseException as error:
            self._error = error

    def wait(self) -> T:
        """Until the work ends."""
        before = {number: signal.getsignal(number) for number in SIGNALS}
        # Deaf to a signal is who was born so, such as a job in the background.
        mine = [number for number, handler in before.items() if handler not in (signal.SIG_IGN, None)]
        answered = False
        try:
            self._listen(mine)
            self._thread.start()
            while self._thread.is_alive():
                self._thread.join(POLL_S)
                self._listen(mine)  # again and again: COLMAP takes SIGTERM for itself when it is loaded
                if self._heard and not answered:
                    answered = True
                    self._ask()
                if self._heard and self._patience() < 0 and self._thread.is_alive():
                    self._end()
        finally:
            for number in mine:
                signal.signal(number, before[number])
        return self._outcome()

    def _listen(self, numbers: Sequence[signal.Signals]) -> None:
        for number in numbers:
            signal.signal(number, self._hear)

    def _hear(self, number: int, _: FrameType | None) -> None:
        self._number = self._number or number
        self._heard.append(time.monotonic())

    def _patience(self) -> float:
        """Seconds for which the work may go on."""
        first, last = self._heard[0], self._heard[-1]
        return -1.0 if last - first > SAME_S else first + self._grace_s - time.monotonic()

    def _ask(self) -> None:
        """Answer, and have the work end at its next instruction."""
        if self._number != CPU_LIMIT:  # for which there is nothing to press
            _tell(self._told)
        colmap = sys.modules.get("skymoor.engines.colmap")
        if colmap is not None:
            colmap.STOP.cancel()
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(self._thread.ident or 0), ctypes.py_object(KeyboardInterrupt)
        )
        for pass_on in AT_STOP:
            pass_on(self._number)

    def _end(self) -> NoReturn:
        """End the process in the midst of a library's call; what was computed is on the disk, whole."""
        LOG.warning("stopped by the user within a step")
        _clear()
        _tell(_last_line(self._number))
        with suppress(Exception):
            sys.stdout.flush()
        os._exit(128 + self._number)

    def _outcome(self) -> T:
        if self._error is None and self._results:
            return self._results[0]
        if self._number:
            _clear()  # the interrupt may have come just where the work would have done it
            raise Stopped(self._number) from self._error
        raise self._error or RuntimeError("the work ended without a result")


def _clear() -> None:
    """Give the terminal back, and leave no temporary files."""
    for give_back in AT_END:
        with suppress(Exception):
            give_back()
    remove_temporary()


def _tell(line: str) -> None:
    with suppress(OSError, ValueError):  # the terminal may be gone
        if line:
            sys.stderr.write(f"{line}\n")
            sys.stderr.flush()
