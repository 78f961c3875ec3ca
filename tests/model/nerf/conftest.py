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
def prior_only(toy: Toy) -> NerfModel:
    """What exact depths alone give."""
    return toy.untrained(component_of(toy.exact), toy.exact)


@pytest.fixture(scope="session")
def trained(toy: Toy) -> NerfModel:
    """From exact depths."""
    return toy.builder(component_of(toy.exact), toy.exact)


@pytest.fixture(scope="session")
def rough(toy: Toy) -> NerfModel:
    """From noisy depths with holes."""
    return toy.builder(component_of(toy.rough), toy.rough)
