# SPDX-License-Identifier: Apache-2.0
"""What long work says in a pipe."""

from __future__ import annotations

import pytest

from skymoor.cli import progress as screen
from skymoor.cli.progress import Screen


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
