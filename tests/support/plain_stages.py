# SPDX-License-Identifier: Apache-2.0
"""Stages that take no time, in a module that imports nothing of skymoor: their keys are found at once."""

from __future__ import annotations

from typing import Any

import numpy as np


def drawn(seed: int) -> np.ndarray:
    """Some numbers."""
    return np.random.default_rng(seed).normal(size=3000)


def doubled(x: np.ndarray) -> dict[str, Any]:
    """Twice as much."""
    return {"sum": float(x.sum()), "x": x * 2}
