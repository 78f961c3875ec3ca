# SPDX-License-Identifier: Apache-2.0
"""The part of the QGIS plugin that needs no QGIS: arguments, messages, and the life of the process."""

from __future__ import annotations

import ast
import json
import os
import time
from pathlib import Path

import pytest

from skymoor.cli.main import _parse
from support.qgis_plugin import plugin_module, write_command

command = plugin_module("command")
REFERENCE = {"out": "result", "ortho": "ortho.tif", "dsm": "dsm.tif", "vertical_datum": "ellipsoid"}


def test_photos_become_a_run() -> None:
    words = command.arguments_of("skymoor", airborne=["a b"], ground=["walk"], ce90=2.1, le90=3.8, **REFERENCE)
    found = _parse(words[1:])  # as skymoor itself reads them
    assert type(found).__name__ == "Run" and found.quiet
    assert [str(path) for path in found.airborne] == ["a b"] and [str(path) for path in found.ground] == ["walk"]
    assert (found.ortho, found.dsm, found.vertical_datum) == ("ortho.tif", "dsm.tif", "ellipsoid")
    assert (found.ce90, found.le90, found.accuracy, str(found.out)) == (2.1, 3.8, None, "result")


def test_a_model_becomes_a_registration_without_heights_or_accuracy() -> None:
    words = command.arguments_of("skymoor", model=["flight.tif", "flight_dsm.tif"], out="result", ortho="ortho.tif")
    found = _parse(words[1:])
    assert type(found).__name__ == "Register" and [str(path) for path in found.model] == [
        "flight.tif",
        "flight_dsm.tif",
    ]
    assert (found.dsm, found.vertical_datum, found.ce90, found.accuracy) == (None, None, None, "unknown")


def test_what_cannot_be_right_is_told_before_anything_starts() -> None:
    with pytest.raises(command.CommandError, match="name a folder of photos"):
        command.arguments_of("skymoor", **REFERENCE)
    with pytest.raises(command.CommandError, match="both CE90 and LE90"):
        command.arguments_of("skymoor", airborne=["a"], ce90=2.0, **REFERENCE)
    with pytest.raises(command.CommandError, match="no such command; install skymoor"):
        command.found_command("/nowhere/skymoor")


def test_the_python_of_qgis_is_not_passed_on() -> None:
    found = command.environment(
        {"PYTHONHOME": "/usr", "PYTHONPATH": "/usr/share/qgis", "PROJ_LIB": "x", "HOME": "/home"}
    )
    assert found == {"HOME": "/home", "PYTHONUNBUFFERED": "1"}


@pytest.mark.parametrize(
    ("line", "stage"),
    [
        ("airborne-0.search: 12 done in 1 min", "airborne-0.search"),
        ("nadir view: 1 done in 0.2 s", "nadir view"),
        ("reference: done in 1 s", "reference"),
        ("airborne: reconstruction: 104 done in 2 min", "airborne: reconstruction"),
        ("airborne: reconstruction: from the cache", "airborne: reconstruction"),
        ("search: scale 3 of 9", None),
        ("skymoor: dsm.tif: there is no such file", None),
    ],
)
def test_stages_are_read_from_lines(line: str, stage: str | None) -> None:
    assert command.ended_stage(line) == stage


def test_progress_rises_and_leaves_the_end_to_the_end() -> None:
    shares = [command.share_done(count) for count in range(60)]
    assert shares[0] == 0 and shares == sorted(set(shares)) and 90 < shares[-1] < 100


def test_refusals_are_results(tmp_path: Path) -> None:
    parts = [
        {"component": 0, "status": "REGISTERED", "reason": "", "predicted_ce90_m": 2.16, "predicted_le90_m": None},
        {"component": 1, "status": "NOT_REGISTERED", "reason": "a competing hypothesis scores 85"},
    ]
    sets = [
        {"set": "airborne", "components": parts},
        {"set": "ground0", "components": [], "reason": "no two photos agree"},
    ]
    (tmp_path / "summary.json").write_text(json.dumps({"sets": sets}))
    found = command.outcome(3, ["results in result"], tmp_path)
    assert not found.registered and found.lines[0] == "airborne_0: registered, CE90 2.2 m"
    assert found.lines[1].endswith("no position is written: a competing hypothesis scores 85")
    assert found.lines[2] == "ground0: not registered: no two photos agree"


@pytest.mark.parametrize(
    ("status", "lines", "words"),
    [
        (2, ["reading", "skymoor: dsm.tif: has no CRS; assign one"], "the input is not accepted: dsm.tif: has no CRS"),
        (1, ["Traceback (most recent call last):", "KeyError: 3"], "skymoor failed with exit status 1: KeyError: 3"),
        (-9, [], "exit status -9: it said nothing"),
    ],
)
def test_errors_are_the_line_of_skymoor(status: int, lines: list[str], words: str, tmp_path: Path) -> None:
    with pytest.raises(command.CommandError, match=words) as caught:
        command.outcome(status, lines, tmp_path)
    assert "\n" not in str(caught.value)


def test_a_run_without_a_summary_is_told(tmp_path: Path) -> None:
    with pytest.raises(command.CommandError, match=r"summary\.json: cannot be read"):
        command.outcome(0, [], tmp_path)


def test_lines_and_exit_status_come_back(tmp_path: Path) -> None:
    script = write_command(tmp_path, "echo one; echo two >&2; exit 3")
    heard: list[str] = []
    assert command.run([str(script)], heard.append, lambda: False) == 3
    assert heard == ["one", "two"]


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize("stubborn", [False, True])
def test_cancelling_ends_the_process_and_its_children(
    stubborn: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "PATIENCE_S", 0.5)
    trap = "trap '' TERM" if stubborn else f"trap 'echo asked > {tmp_path}/asked; kill $child; exit 143' TERM"
    script = write_command(tmp_path, f"sleep 60 & child=$!\n{trap}\necho $$ $child > {tmp_path}/ids; wait; wait")
    start = time.monotonic()
    assert command.run([str(script)], lambda _: None, (tmp_path / "ids").is_file) is None
    assert time.monotonic() - start < 10 and (tmp_path / "asked").is_file() is not stubborn
    for one in (tmp_path / "ids").read_text().split():
        assert not _alive(int(one))


def _alive(number: int) -> bool:
    """Whether a process runs; one that has ended and waits for its parent does not."""
    for _ in range(20):
        try:
            state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return False
        if state == "Z":
            return False
        time.sleep(0.05)
    return True


def test_the_python_is_that_of_old_versions_of_qgis() -> None:
    # QGIS 3.22 brings Python 3.9 on Windows.
    for path in sorted(Path(command.__file__).parent.glob("*.py")):
        ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 9))
