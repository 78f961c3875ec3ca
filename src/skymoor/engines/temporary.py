# SPDX-License-Identifier: Apache-2.0
"""Folders for files that other programs read and write, which are gone when the work ends, however it ends."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

OPEN: set[Path] = set()


@contextmanager
def temporary_folder(parent: Path | None = None, prefix: str = "skymoor-") -> Iterator[Path]:
    """A new folder in `parent`, or where temporary files belong, for the time of the block.

    Raises `OSError` where it cannot be made.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    OPEN.add(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        OPEN.discard(folder)


def remove_temporary_folders() -> None:
    """Remove those of blocks that will not end, because the process does."""
    for folder in tuple(OPEN):
        for _ in range(3):  # a thread that still writes there may add a file while others are deleted
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.exists():
                break
