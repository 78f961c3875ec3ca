# SPDX-License-Identifier: Apache-2.0
"""What the registration asks of a matcher, and of what says which images are worth matching."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from skymoor.types import Array, Raster, Warp


class DenseMatcher(Protocol):
    """For each pixel of one image its place in the other, both ways.

    The images have about the same scale and heading; a search in front sees to that, for learned matchers are not
    rotation-invariant either.
    """

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match both ways; confidence 0 where nothing can be said."""


class Retriever(Protocol):
    """Which tiles may show what a photo shows, by a look at whole images.

    All queries come at once, so that each tile is looked at once, and so that what is common to all photos, or to all
    renders, can be told from what is special.
    """

    def __call__(self, queries: Sequence[Raster], tiles: Sequence[Raster]) -> Array:
        """Likeness (n queries, n tiles), the higher the better; comparable within a row only."""
