# SPDX-License-Identifier: Apache-2.0
"""Many pairs of images for one matcher: together where it can do that."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from skymoor.types import Raster, Warp

Pair = tuple[Raster, Raster]


class BatchMatcher(Protocol):
    """A dense matcher that a GPU keeps busy with several pairs at once."""

    def many(self, pairs: Iterable[Pair]) -> Iterator[Warp]:
        """The warp of each pair, in order; pairs are taken as they are needed."""


def match_many(matcher: Callable[[Raster, Raster], Warp], pairs: Iterable[Pair]) -> Iterator[Warp]:
    """The warp of each pair, in order, as a `BatchMatcher` gives them or one by one."""
    many: Callable[[Iterable[Pair]], Iterator[Warp]] | None = getattr(matcher, "many", None)
    if many is None:
        return (matcher(a, b) for a, b in pairs)
    return many(pairs)
