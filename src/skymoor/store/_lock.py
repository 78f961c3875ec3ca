# SPDX-License-Identifier: Apache-2.0
"""One run at a time in a run directory."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from skymoor.errors import InputError

LOCK = ".lock"
WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP)  # some network file systems


def lock_folder(folder: Path, note: Callable[[str], None]) -> BaseFileLock:
    """The lock of a folder, held until it is released or the process ends.

    Raises `InputError` when another run holds it, or the folder cannot be written.
    """
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise InputError(
            f"{folder}: another run is writing here; wait for it or give another folder with --out"
        ) from None
    except OSError as error:
        if error.errno not in WITHOUT_LOCKS:
            raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from error
        note(f"{folder}: this file system has no locks ({error.strerror}); do not start a second run here")
    return lock
