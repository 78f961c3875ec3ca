# SPDX-License-Identifier: Apache-2.0
"""What the registration asks of a matcher."""

from __future__ import annotations

from typing import Protocol

from skymoor.types import Raster, Warp


class DenseMatcher(Protocol):
    """For each pixel of one picture its place in the other, both ways.

    The pictures have about the same scale and heading; a search in front sees to that, for learned matchers are not
    rotation-invariant either.
    """

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match both ways; confidence 0 where nothing can be said."""
