# SPDX-License-Identifier: Apache-2.0
"""Protocols of matchers and of image retrieval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from skymoor.types import Array, Raster, Warp


class DenseMatcher(Protocol):
    """Dense matcher: for each pixel of one image its position in the other, in both directions.

    The images must have about the same scale and rotation, which the preceding search provides: learned matchers
    are not rotation-invariant either.
    """

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match in both directions; confidence 0 where there is no match."""


class PointMatcher(Protocol):
    """Matcher of key points of two images of about the same scale and rotation."""

    def __call__(self, a: Raster, b: Raster) -> tuple[Array, Array]:
        """Pixels (n, 2) of a and of b that show the same; the centre of the first pixel is (0.5, 0.5)."""


class Retriever(Protocol):
    """Image retrieval: ranks tiles by their global similarity to a photo.

    All queries are passed at once, so that each tile is described once, and what all photos or all renders have in
    common can be removed.
    """

    def __call__(self, queries: Sequence[Raster], tiles: Sequence[Raster]) -> Array:
        """Similarity (n queries, n tiles), higher is better; comparable within a row only."""
