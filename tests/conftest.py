# SPDX-License-Identifier: Apache-2.0
"""Fixtures for the whole session."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

# Before anything imports the libraries that read it: no test asks a hub for anything, not even whether it is there.
os.environ["HF_HUB_OFFLINE"] = "1"
# Workers of pytest-xdist share the cores: with threads of their own they would wait for each other.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import numpy as np
import pytest

from skymoor.simulate.plan import dates_of
from skymoor.simulate.site import Site, write_site
from support.flight import OPTIONS, Flight, SmallWorld, flight_of
from support.offline import offline
from support.pictures import Overhead, overhead
from support.sharing import shared
from support.small_run import run

LONG = ("test_notebook", "test_interrupted_runs")
"""Modules whose tests are long though they do not run the whole job."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Workers take half each and then from each other: so most fixtures of modules are made by one of them only."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first, so that no worker waits for another at the end."""
    items.sort(key=lambda item: item.get_closest_marker("e2e") is None and item.path.stem not in LONG)


@pytest.fixture
def rng() -> np.random.Generator:
    """The same numbers for every test."""
    return np.random.default_rng(7)


@pytest.fixture(scope="session")
def small_world(tmp_path_factory: pytest.TempPathFactory) -> SmallWorld:
    """Three buildings, a crossing and a tent, 90 m wide."""
    return SmallWorld(OPTIONS, tmp_path_factory)


@pytest.fixture(scope="session")
def small_site(tmp_path_factory: pytest.TempPathFactory, small_world: SmallWorld) -> Site:
    """The small world as files, with a reference of another day that is off; do not write into it.

    Beside its site.toml are an airborne.toml and a ground.toml, each with one kind of photos only.
    """

    def make() -> Site:
        site = write_site(small_world, tmp_path_factory.mktemp("simulated") / "site")
        before, airborne, ground = re.split(r"(?=\[airborne\]|\[\[ground\]\])", site.toml.read_text())
        (site.folder / "airborne.toml").write_text(before + airborne)
        (site.folder / "ground.toml").write_text(before + ground)
        return site

    return shared(tmp_path_factory, "site", make)


@pytest.fixture(scope="session")
def flight(small_world: SmallWorld, small_site: Site) -> Flight:
    """Its 16 airborne photos: a ring that looks down at 55 degrees, and six from above."""
    return flight_of(small_world, small_site)


@pytest.fixture(scope="session")
def first_day(tmp_path_factory: pytest.TempPathFactory, small_world: SmallWorld) -> Overhead:
    """The small world from above, on the day of the flight."""
    date = dates_of(OPTIONS).airborne
    return shared(tmp_path_factory, "first_day", lambda: overhead(small_world.scene(date)))


@pytest.fixture(scope="session")
def next_door(tmp_path_factory: pytest.TempPathFactory, small_world: SmallWorld) -> Overhead:
    """Another place, of the same kind and on the same day: what lies 200 m to the east."""
    date = dates_of(OPTIONS).airborne
    return shared(tmp_path_factory, "next_door", lambda: overhead(small_world.scene(date), east_m=200.0))


@pytest.fixture(scope="session")
def other_day(tmp_path_factory: pytest.TempPathFactory, small_world: SmallWorld) -> Overhead:
    """The same on the day of the reference: another season, another sun, other cars."""
    date = dates_of(OPTIONS).satellite
    return shared(tmp_path_factory, "other_day", lambda: overhead(small_world.scene(date)))


@pytest.fixture(scope="session")
def finished(small_site: Site, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of its airborne photos, registered; do not write into it."""

    def make() -> Path:
        out = tmp_path_factory.mktemp("run") / "out"
        with offline():  # a run on files touches no network
            assert run(small_site.folder / "airborne.toml", out) == 0
        return out

    return shared(tmp_path_factory, "run", make)
