# SPDX-License-Identifier: Apache-2.0
"""Models of the box on a plane that several tests look at."""

from __future__ import annotations

import pytest

from model.nerf.toy import BUILDER, Toy, component_of, photographs
from skymoor.model.nerf.model import NerfModel


@pytest.fixture(scope="session")
def toy() -> Toy:
    return Toy(photographs(), photographs(noise_ratio=0.004, missing=0.3), BUILDER)


@pytest.fixture(scope="session")
def trained(toy: Toy) -> NerfModel:
    """From rough depths."""
    return toy.builder(component_of(toy.rough), toy.rough)


@pytest.fixture(scope="session")
def untrained(toy: Toy) -> NerfModel:
    """The prior of the same depths."""
    return toy.untrained()(component_of(toy.rough), toy.rough)
