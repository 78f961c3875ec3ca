# SPDX-License-Identifier: Apache-2.0
"""What the reconstruction asks of a feature engine."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from skymoor.types import Photos, Progress


class PairMatcher(Protocol):
    """Finds what pairs of photos have in common.

    Fills the COLMAP database at `database` with one image per photo, named by `colmap_name`, its cameras,
    key points and geometrically verified matches. It may use `folder` for files of its own.
    """

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Detect, match and verify."""


def colmap_name(index: int, size: tuple[int, int]) -> str:
    """The name of photo `index` in the database; photos of one size share a folder and so can share a camera."""
    return f"{size[0]}x{size[1]}/{index:06d}.pgm"
