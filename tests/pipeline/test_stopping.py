# SPDX-License-Identifier: Apache-2.0
"""A run that stops after a step leaves that step in the cache, and nothing else; a whole run goes on from there."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import skymoor
from skymoor.simulate.site import Site
from support.small_run import rows_of, run, summary_of
from support.tiny_site import content, make_site
from support.tiny_site import run as run_tiny

REDONE = ("depths", "model", "nadir", "search")


def stages(out: Path) -> set[str]:
    """Those of REDONE that are in the cache."""
    return {name for name in REDONE if list(out.glob(f"stages/airborne-0.{name}-*.npz"))}


@pytest.mark.e2e
def test_each_step_is_the_last_if_asked_and_a_whole_run_goes_on(
    finished: Path, small_site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The reconstruction of a finished run, to save the time of another one, and what comes after the search.
    out, toml = tmp_path / "out", small_site.folder / "airborne.toml"
    out.mkdir()
    shutil.copytree(finished / "stages", out / "stages")
    for name in REDONE:
        for file in out.glob(f"stages/airborne-0.{name}-*.npz"):
            file.unlink()
    for step, there in (("reconstruct", ()), ("depth", ("depths",)), ("search", REDONE)):
        assert run(toml, out, "--stop-after", step) == 0
        assert stages(out) == set(there)
        assert {path.name for path in out.iterdir()} == {"stages", "run.log", ".lock"}  # no product
        told = capsys.readouterr().out
        assert f"stopped after {step}, as asked; the same command without --stop-after goes on from there" in told
    assert run(toml, out) == 0
    assert all(stage["cached"] for stage in summary_of(out)["stages"])
    assert rows_of(out / "cameras.csv") == rows_of(finished / "cameras.csv")
    # Products of the whole run stay as they are where a later one stops.
    before = content(out)
    assert run(toml, out, "--stop-after", "search", "--set", "register.min_score=500") == 0
    after = content(out)
    assert {name for name in after if after[name] != before.get(name)} <= {"run.log", "stages/files.json"}


def test_what_did_not_come_so_far_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path / "site")
    assert run_tiny(site, "--stop-after", "depth") == 0
    assert "airborne: no model was found in these photos" in capsys.readouterr().out
    assert "INFO stopped after depth" in (site / "out/run.log").read_text()
    assert run_tiny(site, "--stop-after", "depth", "--json") == 0
    assert json.loads(capsys.readouterr().out) == {"out": str(site / "out"), "stopped_after": "depth"}


def test_in_python_it_has_a_name(tmp_path: Path) -> None:
    site = make_site(tmp_path / "site")
    with pytest.raises(skymoor.StoppedAfter, match="stopped after reconstruct") as stop:
        skymoor.register(site, out=tmp_path / "out", stop_after="reconstruct")
    assert stop.value.step == "reconstruct"
    with pytest.raises(skymoor.InputError, match=r"stop_after='depths': give one of reconstruct, depth, search"):
        skymoor.register(site, out=tmp_path / "out", stop_after="depths")  # type: ignore[arg-type]
