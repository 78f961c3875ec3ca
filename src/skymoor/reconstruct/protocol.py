# SPDX-License-Identifier: Apache-2.0
"""Interfaces of the engines of the reconstruction: feature matcher and filter of look-alike pairs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from skymoor.types import Array, Component, Photos, Progress


class PairMatcher(Protocol):
    """Feature matcher used by structure from motion.

    Fills the COLMAP database at `database` with one image per photo, named by `colmap_name`, its cameras,
    key points and geometrically verified matches. It may use `folder` for temporary files.
    """

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Detect, match and verify."""


@dataclass(frozen=True, eq=False)
class ViewGraph:
    """Photos, their matched pairs, and a first reconstruction from these.

    `pairs` are photo numbers (i, j); the matches of pair k are `matches[k]` (m, 4): u, v in photo i and u, v in photo
    j. Each of `components` is in a frame of its own, has the image names of `photos`, and may be wrong (folded).
    """

    photos: Photos
    pairs: tuple[tuple[int, int], ...]
    matches: tuple[Array, ...]
    components: tuple[Component, ...]


class PairFilter(Protocol):
    """Finds pairs of photos that match although they show different places.

    `rounds` is the largest number of calls: photos are mapped again after each call that drops pairs.
    """

    @property
    def rounds(self) -> int: ...

    def __call__(self, graph: ViewGraph) -> list[int]:
        """Rows of `graph.pairs` that are to be kept, in order."""


def colmap_name(index: int, size: tuple[int, int]) -> str:
    """The name of photo `index` in the database; photos of one size share a folder and so can share a camera."""
    return f"{size[0]}x{size[1]}/{index:06d}.pgm"
