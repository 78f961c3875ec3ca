# SPDX-License-Identifier: Apache-2.0
"""Files and folders that are gone when the work ends, however it ends."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

OPEN: set[Path] = set()


@contextmanager
def gone_at_the_end(path: Path) -> Iterator[Path]:
    """Remove a file or folder, if it is still there, when the block ends or the process is ended within it."""
    OPEN.add(path)
    try:
        yield path
    finally:
        _remove(path)
        OPEN.discard(path)


@contextmanager
def temporary_folder(parent: Path | None = None, prefix: str = "skymoor-") -> Iterator[Path]:
    """A new folder in `parent`, or where temporary files belong, for the time of the block: other programs write there.

    Raises `OSError` where it cannot be made.
    """
    with gone_at_the_end(Path(tempfile.mkdtemp(prefix=prefix, dir=parent))) as folder:
        yield folder


def is_kept(folder: Path) -> bool:
    """Whether a folder is whole whose block goes on: the end of the process has not begun to remove it."""
    return folder in OPEN


def remove_temporary() -> None:
    """Remove what blocks would that will not end, because the process does."""
    for path in tuple(OPEN):
        OPEN.discard(path)  # first: who works there can tell what is missing from what was removed
        for _ in range(3):  # a thread that still writes there may add a file while others are deleted
            _remove(path)
            if not path.exists():
                break


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):  # the error before this is the one to report
            path.unlink(missing_ok=True)
