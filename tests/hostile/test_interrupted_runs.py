# SPDX-License-Identifier: Apache-2.0
"""Ctrl+C and SIGTERM within COLMAP and within a call that hears nothing: an answer, an end in time, nothing left."""

from __future__ import annotations

import os
import re
import signal
import time
from pathlib import Path

import pytest
from PIL import Image

from skymoor.cli.interrupt import GRACE_S, SAME_S, STOPPED, STOPPING
from skymoor.simulate.site import Site
from support.flight import Flight
from support.interrupted import run_site_within, started, until
from support.small_run import arguments

PATIENCE_S = 12.0
"""More than the end takes on a machine that has other work, and far less than the call would."""
MATCHING = ("pycolmap", "match_image_pairs", True)
MAPPING = ("pycolmap", "incremental_mapping", True)
DEPTHS = ("skymoor.densify._sgm", "pair_depth", False)


@pytest.fixture(scope="module")
def site(flight: Flight, small_site: Site, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven photos of the small site."""
    folder = tmp_path_factory.mktemp("few")
    (folder / "airborne").mkdir()
    for k, photo in enumerate(list(flight.images.values())[:7]):
        Image.fromarray(photo).save(folder / f"airborne/{k}.png")
    before = small_site.toml.read_text().partition("[airborne]")[0]
    before = before.replace('"reference/', f'"{small_site.folder}/reference/')
    (folder / "site.toml").write_text(f'{before}[airborne]\nimages = "airborne"\n')
    return folder / "site.toml"


def stopped(
    site: Path, out: Path, folder: Path, within: tuple[str, str, bool], *signals: int, grace_s: float = GRACE_S
) -> tuple[int | None, list[str], float]:
    """Exit status, what the screen said at the end, and how long that took, of a run that gets these signals."""
    folder.mkdir()
    process = started(run_site_within, arguments(site, out), folder, *within, grace_s)
    until(folder / "begun", process)
    start = time.monotonic()
    assert process.pid is not None
    for k, number in enumerate(signals):
        time.sleep(2 * SAME_S if k else 0.0)
        os.kill(process.pid, number)
    process.join(GRACE_S + PATIENCE_S)
    seconds = time.monotonic() - start
    process.kill()
    process.join()
    assert not list((folder / "temporary").iterdir())
    assert not list(out.rglob(".skymoor-*"))
    screen = (folder / "screen").read_text()
    assert "Aborted at" not in screen and "Traceback" not in screen
    assert not re.search(r"^[IWEF]\d{4,8} ", screen, re.MULTILINE)  # lines of COLMAP's log
    return process.exitcode, screen.splitlines()[-2:], seconds


def test_the_same_command_continues_after_each_stop(site: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    answers = [STOPPING, STOPPED]
    status, said, seconds = stopped(site, out, tmp_path / "matching", MATCHING, signal.SIGINT)
    assert (status, said) == (130, answers) and seconds < GRACE_S + PATIENCE_S
    status, said, seconds = stopped(site, out, tmp_path / "mapping", MAPPING, signal.SIGTERM)
    assert (status, said) == (143, answers) and seconds < GRACE_S + PATIENCE_S
    status, said, seconds = stopped(site, out, tmp_path / "depths", DEPTHS, signal.SIGINT)
    assert (status, said) == (130, answers) and GRACE_S < seconds < GRACE_S + PATIENCE_S
    log = (out / "run.log").read_text()
    assert log.count("stopped by the user") == 3 and log.count("photos: from the cache") == 2
    twice = (signal.SIGINT, signal.SIGINT)
    status, said, seconds = stopped(site, out, tmp_path / "twice", DEPTHS, *twice, grace_s=1000.0)
    assert (status, said) == (130, answers) and seconds < GRACE_S + PATIENCE_S
    assert "reconstruct: from the cache" in (out / "run.log").read_text()
