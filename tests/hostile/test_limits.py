# SPDX-License-Identifier: Apache-2.0
"""Limits of the system, as ulimit sets them: one line, nothing half-written, and the same command goes on without."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from skymoor.cli import main as command
from skymoor.cli.limits import LEAST_BYTES, no_memory
from support.interrupted import started
from support.tiny_site import content, make_site, run

if sys.platform == "win32":
    pytest.skip("there are no such limits on Windows", allow_module_level=True)
import resource

CPU, FILES, OPEN, SPACE = resource.RLIMIT_CPU, resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE, resource.RLIMIT_AS


def run_limited(kind: int, value: int, site: Path, screen: Path, spent_s: float = 0.0) -> None:
    """`skymoor run` where no more is allowed; its errors go to a file. `spent_s` of CPU time are used up before."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(screen, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    begin = time.process_time()
    while time.process_time() < begin + spent_s:
        pass
    value += len(os.listdir("/proc/self/fd")) if kind == OPEN else 0  # noqa: PTH208
    resource.setrlimit(kind, (value, resource.getrlimit(kind)[1]))
    os._exit(command.main(["run", str(site / "site.toml"), "--out", str(site / "out"), "--quiet"]))


def status_and_line(kind: int, value: int, site: Path, folder: Path, spent_s: float = 0.0) -> tuple[int | None, str]:
    process = started(run_limited, kind, value, site, folder / "screen", spent_s)
    process.join(60)
    assert process.exitcode is not None, "it hangs"
    (line,) = (folder / "screen").read_text().strip().splitlines()
    return process.exitcode, line


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        (FILES, 1_000, "cannot be written"),
        (FILES, 60_000, "ulimit -f"),
        (OPEN, 0, "Too many open files"),
        (SPACE, LEAST_BYTES - 1, "ulimit -v"),
    ],
)
def test_one_line_and_nothing_is_lost(kind: int, value: int, words: str, tmp_path: Path) -> None:
    site = make_site(tmp_path / "site")
    before = content(site)
    status, line = status_and_line(kind, value, site, tmp_path)
    assert status == 2 and line.startswith("skymoor: ") and words in line
    after = content(site)
    assert before.items() <= after.items()
    assert all(name.startswith(("out/stages/", "out/.lock", "out/run.log")) for name in after.keys() - before.keys())
    assert not [name for name in after if ".skymoor-" in name]
    assert run(site) == 3
    assert (site / "out/summary.json").exists()


def test_the_end_of_cpu_time_is_told(tmp_path: Path) -> None:
    site = make_site(tmp_path / "site")
    status, line = status_and_line(CPU, 1, site, tmp_path, spent_s=1.5)
    assert status == 128 + signal.SIGXCPU
    assert "ulimit -t" in line and "continues from here" in line
    assert run(site) == 3


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        MemoryError("Unable to allocate 9 GiB"),
        RuntimeError("can't start new thread"),
        ImportError("libgdal.so: failed to map segment from shared object"),
    ],
)
def test_too_little_memory_is_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(_: object) -> int:
        try:
            raise error
        except Exception as first:
            raise RuntimeError("cannot import the backend") from first

    monkeypatch.setattr(command, "_done", fails)
    assert command.main(["version"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "not enough memory" in line and "ulimit -v" in line


def test_other_errors_are_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: object) -> int:
        raise RuntimeError("a bug")

    monkeypatch.setattr(command, "_done", fails)
    with pytest.raises(RuntimeError, match="a bug"):
        command.main(["version"])
    assert no_memory(ValueError("a bug")) == ""
