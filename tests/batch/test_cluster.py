# SPDX-License-Identifier: Apache-2.0
"""A real Dask cluster of processes: a worker that is killed loses no site, and a scheduler only those that run."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from skymoor.batch.cluster import ClusterLost, run_on_cluster
from skymoor.batch.sites import find_sites
from skymoor.batch.work import run_site
from skymoor.cli.main import main
from support.tiny_site import make_site

distributed = pytest.importorskip("distributed", reason="needs skymoor[dask]")
COUNT = 3


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("many")
    first = make_site(folder / "site0")
    for k in range(1, COUNT):
        shutil.copytree(first, folder / f"site{k}")
    return folder


@pytest.fixture
def cluster() -> Iterator[object]:
    options = {"processes": True, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(n_workers=2, **options) as made:
        yield made


def kill_a_worker_that_works(cluster: object) -> int:
    """Kill the process of a worker that has a site in hand; returns its number."""
    for _ in range(200):
        for worker in cluster.workers.values():  # type: ignore[attr-defined]
            known = cluster.scheduler.workers.get(worker.worker_address)  # type: ignore[attr-defined]
            if known is not None and known.processing:
                os.kill(worker.pid, signal.SIGKILL)
                return int(worker.pid)
        time.sleep(0.02)
    raise AssertionError("no worker ever worked")


def test_a_killed_worker_loses_no_site(sites: Path, cluster: object, tmp_path: Path) -> None:
    killed: list[int] = []
    threading.Timer(0.8, lambda: killed.append(kill_a_worker_that_works(cluster))).start()
    address = cluster.scheduler_address  # type: ignore[attr-defined]
    out = tmp_path / "out"
    assert main(["batch", str(sites), "--out", str(out), "--scheduler", address, "--quiet"]) == 3
    assert len(killed) == 1
    state = json.loads((out / "batch.json").read_text())
    assert [one["verdict"] for one in state["sites"]] == ["NOT_REGISTERED"] * COUNT
    for k in range(COUNT):
        assert (out / f"site{k}/report.html").is_file()


def test_workers_send_results_to_a_store_that_all_see(
    sites: Path, cluster: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    address = cluster.scheduler_address  # type: ignore[attr-defined]
    command = ["batch", str(sites), "--scheduler", address, "--stop-after", "reconstruct", "--quiet", "--out"]
    assert main([*command, f"file://{tmp_path}/out"]) == 0
    state = json.loads((tmp_path / "out/batch.json").read_text())
    assert [one["verdict"] for one in state["sites"]] == ["STOPPED"] * COUNT
    for k in range(COUNT):
        assert list((tmp_path / f"out/site{k}/stages").glob("reconstruct-*.npz"))
    capsys.readouterr()
    assert main([*command, "memory://out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "memory://out" in line and "workers do not see the memory of this process" in line


def test_a_lost_scheduler_is_told_and_the_same_command_goes_on(sites: Path, tmp_path: Path) -> None:
    options = {"processes": True, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    tasks = find_sites([sites], tmp_path / "out")
    ended = []
    made = distributed.LocalCluster(n_workers=1, **options)
    with made, pytest.raises(ClusterLost, match="the same command goes on"):
        for outcome in run_on_cluster(made.scheduler_address, tasks, [], memory_gb=None):
            ended.append(outcome.name)
            made.close()
    assert 1 <= len(ended) < COUNT
    again = run_site(next(task for task in tasks if task.name == ended[0]))
    assert again.verdict == "NOT_REGISTERED"
    stages = json.loads((again.out / "summary.json").read_text())["stages"]
    assert all(stage["cached"] for stage in stages if stage["name"] in ("photos", "reference"))


def test_an_address_where_nothing_answers_is_told(
    sites: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skymoor.batch.cluster.CONNECT_S", 1)
    arguments = ["batch", str(sites), "--out", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:1", "--quiet"]
    assert main(arguments) == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err
