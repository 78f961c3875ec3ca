# SPDX-License-Identifier: Apache-2.0
"""One site's failure ends no other; what has ended is kept; the same command goes on."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from skymoor.batch.local import run_here
from skymoor.batch.sites import Outcome, SiteTask, exit_status_of, find_sites
from skymoor.batch.work import run_site
from skymoor.cli.main import main
from skymoor.errors import InputError
from support.tiny_site import make_site


@pytest.fixture
def sites(tmp_path: Path) -> Path:
    """Two that can be read but not placed, and one whose orthophoto is missing."""
    folder = tmp_path / "sites"
    first = make_site(folder / "a")
    for name in ("b", "broken"):
        shutil.copytree(first, folder / name)
    (folder / "broken/ortho.tif").unlink()
    return folder


def test_sites_are_found_by_file_folder_and_folder_of_folders(sites: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tasks = find_sites([sites], out)
    assert [task.name for task in tasks] == ["a", "b", "broken"]
    assert tasks[0].toml == sites / "a/site.toml" and tasks[0].out == out / "a"
    assert find_sites([sites / "a", sites / "b/site.toml"], out) == tasks[:2]
    assert find_sites([sites, sites / "a"], out) == tasks  # once each
    elsewhere = Path(shutil.copytree(sites / "a", tmp_path / "more/a"))
    assert [task.name for task in find_sites([sites / "a", elsewhere], out)] == ["a", "a-2"]
    assert [task.name for task in find_sites([sites], out, only=["b"])] == ["b"]
    with pytest.raises(InputError, match="no such site"):
        find_sites([sites], out, only=["d"])
    with pytest.raises(InputError, match="name site"):
        find_sites([tmp_path / "nowhere"], out)
    with pytest.raises(InputError, match=r"has no site\.toml"):
        find_sites([sites / "a/airborne"], out)


def test_a_bad_site_ends_no_other(sites: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["batch", str(sites), "--out", str(out), "--workers", "2", "--quiet"]) == 2
    state = json.loads((out / "batch.json").read_text())
    verdicts = {one["name"]: one["verdict"] for one in state["sites"]}
    assert verdicts == {"a": "NOT_REGISTERED", "b": "NOT_REGISTERED", "broken": "BAD_INPUT"}
    (broken,) = (one for one in state["sites"] if one["name"] == "broken")
    assert "ortho" in broken["message"] and state["waiting"] == []
    page = (out / "batch.html").read_text()
    assert 'href="a/report.html"' in page and "BAD_INPUT" in page and "3 of 3 sites have ended" in page
    assert "broken: BAD_INPUT" in capsys.readouterr().out
    # Mended, the same command goes on: the others come from their caches.
    shutil.copy(sites / "a/ortho.tif", sites / "broken/ortho.tif")
    assert main(["batch", str(sites), "--out", str(out), "--only", "broken", "--only", "a", "--quiet"]) == 3
    stages = json.loads((out / "a/summary.json").read_text())["stages"]
    assert any(stage["cached"] for stage in stages)


def test_a_process_beyond_its_memory_fails_alone(sites: Path, tmp_path: Path) -> None:
    task = SiteTask("a", sites / "a/site.toml", tmp_path / "out/a")
    outcome = run_site(task, memory_gb=0.05)
    assert outcome.verdict == "FAILED" and str(task.out) in outcome.message
    assert run_site(task).verdict == "NOT_REGISTERED"  # and nothing of it is left


def test_a_full_disk_is_told_and_loses_nothing(sites: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    tasks = [SiteTask("a", sites / "a/site.toml", tmp_path / "file/a"), *find_sites([sites / "b"], tmp_path / "out")]
    bad, good = sorted(run_here(tasks, [], workers=2, memory_gb=None), key=lambda one: one.name)
    assert bad.verdict == "BAD_INPUT" and str(tmp_path / "file") in bad.message
    assert good.verdict == "NOT_REGISTERED"


def test_the_exit_status_is_the_worst(tmp_path: Path) -> None:
    def status(*found: int) -> int:
        return exit_status_of([Outcome("x", tmp_path, one, 1.0) for one in found])

    assert [status(0, 0), status(0, 3), status(3, 2, 0), status(0, -9), status(1, 2)] == [0, 3, 2, 1, 1]


def test_it_ends_with_the_process_that_started_it(sites: Path, tmp_path: Path) -> None:
    """A worker that is killed leaves no run behind that would hold the site's folder."""
    child = [sys.executable, "-m", "skymoor.batch.limited", "0", "schema"]
    starter = (
        "import subprocess, sys, time\n"
        f"child = subprocess.Popen({child!r}, stdout=subprocess.PIPE)\n"
        "print(child.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", starter], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        time.sleep(0.3)
        parent.send_signal(signal.SIGKILL)
    for _ in range(100):
        if not Path(f"/proc/{pid}").exists() or _is_zombie(pid):
            return
        time.sleep(0.05)
    os.kill(pid, signal.SIGKILL)
    raise AssertionError("the child lives on")


def _is_zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
