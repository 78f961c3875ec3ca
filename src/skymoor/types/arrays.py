# SPDX-License-Identifier: Apache-2.0
"""Kinds of arrays, and the callback by which long computations tell how far they are."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


class Progress(Protocol):
    """Called with steps done and steps in all, and now and then with a line about how it goes."""

    def __call__(self, done: int, total: int, note: str = "", /) -> None: ...


def no_progress(done: int, total: int, note: str = "", /) -> None:
    """Ignore progress."""
