# SPDX-License-Identifier: Apache-2.0
"""What the command line teaches: help, plans, the state of the machine, answers for scripts, and a log."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

from skymoor.cli import doctor
from skymoor.cli.main import COMMANDS, main
from skymoor.pipeline.estimate import estimate_run
from skymoor.pipeline.log import logged
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import Options
from support.tiny_site import content, make_site, run


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "weights"])
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    shown = capsys.readouterr().out
    assert ended.value.code == 0 and f"usage: skymoor {command}" in shown
    if command in ("run", "evaluate", "simulate"):
        assert f"skymoor {command} " in shown.split("options")[0].split("usage")[1].partition("\n")[2]


@pytest.mark.parametrize(("typed", "meant"), [("rnu", "run"), ("evalute", "evaluate"), ("wieghts", "weights")])
def test_a_misspelt_command_is_understood(typed: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([typed, "site.toml"]) == 2
    assert capsys.readouterr().err == f"skymoor: there is no command {typed}; did you mean {meant}?\n"


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_knows_the_commands(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["completion", shell])
    shown = capsys.readouterr().out
    assert not ended.value.code and "--dry-run" in shown
    assert all(command in shown for command in COMMANDS)


def test_a_dry_run_says_what_it_would_do_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    before = content(site)
    assert run(site, "--dry-run", "--json") == 0
    told = capsys.readouterr()
    steps = json.loads(told.out)["steps"]
    assert [step["name"] for step in steps][:3] == ["reference", "photos", "reconstruct"]
    assert all(step["seconds"] > 0 and step["mib"] > 100 for step in steps)
    assert "nothing was written" in told.err
    assert content(site) == before and not (site / "out").exists()


def test_a_dry_run_finds_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    (site / "airborne/2.png").write_bytes(b"")
    assert run(site, "--dry-run") == 2
    assert "2.png" in capsys.readouterr().err


def test_plans_grow_with_the_work() -> None:
    few, many = ([(800, 600)] * count for count in (20, 200))
    options = Options()

    def seconds(*arguments: object) -> float:
        return sum(step.seconds for step in estimate_run(*arguments))  # type: ignore[arg-type]

    alone = seconds(few, [], 1_000_000, options)
    assert 60 < alone < 600  # forty photos of this size took 211 s, of which reconstruction 122
    assert seconds(many, [], 1_000_000, options) > 4 * alone
    assert seconds(few, [few], 1_000_000, options) > 1.5 * alone
    slow = with_options(options, {"reconstruct.matcher": "dedode_roma"})
    assert seconds(few, [], 1_000_000, slow) > 100 * alone
    assert max(step.mib for step in estimate_run(many, [], 1_000_000, options)) > 1000


def test_the_doctor_sees_what_is_there_and_what_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", "--json", "--out", str(tmp_path / "not" / "yet")]) == 0
    checks = {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    assert checks["pycolmap"]["status"] == checks["disk for results"]["status"] == "ok"
    monkeypatch.setattr(doctor, "LIBRARIES", ("numpy", "no-such-library"))
    monkeypatch.setattr(doctor, "LEAST_FREE_GB", 1e9)
    assert main(["doctor", "--out", str(tmp_path)]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "no-such-library" in shown and "make room" in shown and "missing: no-such-library" in shown


def test_the_doctor_knows_whether_the_report_can_be_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CHROMIUM", "/opt/browser")
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert "/opt/browser" in shown and "all that runs need is here" in shown
    monkeypatch.delenv("CHROMIUM")
    monkeypatch.setenv("PATH", "")
    assert main(["doctor"]) == 0
    assert "environment variable CHROMIUM" in " ".join(capsys.readouterr().out.replace("│", "").split())


def test_a_run_keeps_a_log(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    assert run(site, "--json") == 3
    first = (site / "out/run.log").read_text()
    assert "reconstruct: begins" in first and "reference: " in first and first.rstrip().endswith("done")
    assert run(site) == 3
    both = (site / "out/run.log").read_text()
    assert both.startswith(first) and "reconstruct: from the cache" in both[len(first) :]
    assert not logging.getLogger("skymoor").handlers


@pytest.mark.parametrize("error", [ValueError("ours"), KeyboardInterrupt()])
def test_the_log_says_how_it_ended(error: BaseException, tmp_path: Path) -> None:
    def fail() -> None:
        with logged(tmp_path / "run.log", ["skymoor", "run", "s\udce4te.toml"]):
            raise error

    with pytest.raises(type(error)):
        fail()
    text = (tmp_path / "run.log").read_text(encoding="utf-8")
    assert "skymoor run s" in text
    assert ("Traceback" in text and "ours" in text) if isinstance(error, ValueError) else "stopped by the user" in text


def test_answers_for_scripts_are_json_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    assert run(site, "--json") == 3
    told = capsys.readouterr()
    answer = json.loads(told.out)
    assert [item["status"] for item in answer["sets"]] == ["NOT_REGISTERED"]
    assert "no three photos" in told.err
    assert main(["weights", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {"roma", "aliked"} <= {one["name"] for one in listed["weights"]}
