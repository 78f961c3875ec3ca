# SPDX-License-Identifier: Apache-2.0
"""Fixtures that are slow to make: made once per session, also where pytest-xdist runs several workers."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from flight import Flight, make_flight
from scene import make_scene
from sitefiles import write_site

T = TypeVar("T")


def shared(factory: pytest.TempPathFactory, name: str, make: Callable[[], T]) -> T:
    """What `make` gives, from the first worker that asks for it."""
    root = factory.getbasetemp()
    file = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / f"{name}.pkl"
    with file.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not file.exists():
            file.write_bytes(pickle.dumps(make()))
    value: T = pickle.loads(file.read_bytes())
    return value


@pytest.fixture
def rng() -> np.random.Generator:
    """The same numbers for every test."""
    return np.random.default_rng(7)


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """18 photos of the small world: a ring that looks down at 45 degrees, and six from above."""
    cameras, images = shared(tmp_path_factory, "flight", _photos)
    return Flight(make_scene(), cameras, images)


@pytest.fixture(scope="session")
def site_dir(tmp_path_factory: pytest.TempPathFactory, flight: Flight) -> Path:
    """The small world as files, with a reference of another day that is off by a known bias; do not write into it."""

    def make() -> Path:
        folder = tmp_path_factory.mktemp("site")
        reference = make_scene(cars_seed=1, sun_deg=(205.0, 40.0))
        write_site(folder, flight, reference, bias_m=BIAS_M)
        return folder

    return shared(tmp_path_factory, "site", make)


BIAS_M = (0.4, -0.3, 0.5)


def _photos() -> tuple[object, object]:
    made = make_flight("oblique")
    return made.cameras, made.images
