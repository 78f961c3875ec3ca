# SPDX-License-Identifier: Apache-2.0
"""What is slow to make is made once per test session, also where pytest-xdist runs several workers."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from typing import TypeVar

import pytest
from filelock import FileLock

T = TypeVar("T")


def shared(factory: pytest.TempPathFactory, name: str, make: Callable[[], T]) -> T:
    """What `make` gives, from the first worker that asks for it."""
    root = factory.getbasetemp()
    file = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / f"{name}.pkl"
    with FileLock(file.with_suffix(".lock")):
        if not file.exists():
            file.write_bytes(pickle.dumps(make()))
    value: T = pickle.loads(file.read_bytes())
    return value
