# SPDX-License-Identifier: Apache-2.0
"""Work that a signal ends: by itself where it can, and by its exception where it is deaf."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

import pytest

from skymoor.cli.interrupt import SIGNALS, Stopped, interruptible


@pytest.fixture(autouse=True)
def this_process_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its COLMAP must not stop for good."""
    monkeypatch.delitem(sys.modules, "skymoor.engines.colmap", raising=False)


def test_the_result_and_the_error_of_the_work_are_passed_on() -> None:
    assert interruptible(lambda: 7) == 7
    assert interruptible(lambda: None) is None
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_work_and_others_hear_of_it(
    number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    heard: list[int] = []
    monkeypatch.setattr("skymoor.cli.interrupt.AT_STOP", [heard.append])
    before = [signal.getsignal(one) for one in SIGNALS]
    cleaned = []

    def work() -> None:
        try:
            os.kill(os.getpid(), number)
            while True:
                time.sleep(0.01)
        finally:
            cleaned.append(True)

    with pytest.raises(Stopped) as stop:
        interruptible(work, told="ending")
    assert stop.value.status == 128 + number
    assert cleaned and heard == [number]
    assert capsys.readouterr().err == "ending\n"
    assert [signal.getsignal(one) for one in SIGNALS] == before


def test_work_that_ended_in_time_counts() -> None:
    def work() -> str:
        os.kill(os.getpid(), signal.SIGINT)
        try:
            while True:
                time.sleep(0.01)
        except KeyboardInterrupt:  # as the viewer takes it
            return "stopped"

    assert interruptible(work, told="") == "stopped"


def test_elsewhere_it_is_just_called() -> None:
    """Such as in a worker of Dask: signals are the business of its main thread."""
    found: list[int] = []
    thread = threading.Thread(target=lambda: found.append(interruptible(threading.get_ident)))
    thread.start()
    thread.join()
    assert found == [thread.ident]
