# SPDX-License-Identifier: Apache-2.0
"""Fixtures for the whole session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flight import Flight, make_flight
from scene import make_scene
from sharing import shared
from sitefiles import BIAS_M, write_site


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


def _photos() -> tuple[object, object]:
    made = make_flight("oblique")
    return made.cameras, made.images
