# SPDX-License-Identifier: Apache-2.0
"""Files that are there, have an end, and hold what they should."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import BackendUnavailable, InputError

LONGEST = 300
"""Letters of what a parser says."""


def regular(path: Path) -> Path:
    """The path, if it is that of a file, also by links: to read a pipe or a device may never end.

    Raises `OSError`.
    """
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a pipe or device, and not a file", str(path))
    return path


def is_there(path: Path, *, folder: bool = False) -> bool:
    """Whether there is such a file, or folder; False also for names that no file can have."""
    try:
        return path.is_dir() if folder else path.is_file()
    except (OSError, ValueError):
        return False


@contextmanager
def content_told(path: Path, words: str, remedy: str, *, disk: bool = False) -> Iterator[None]:
    """Turn whatever the content of a file makes its parsers raise into an `InputError`: path, words, reason, remedy.

    Errors of the disk pass, unless `disk`.
    """
    try:
        yield
    except (InputError, BackendUnavailable):
        raise
    except BaseException as error:
        if not (_is_of_content(error) or (disk and isinstance(error, OSError))):
            raise
        reason = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
        # Parsers may repeat all of the file.
        raise InputError(f"{path}: {words} ({reason[:LONGEST]}); {remedy}") from error


def _is_of_content(error: BaseException) -> bool:
    """Whether an error came of what a file holds, as parsers raise them in many ways, and not of the disk.

    A library in Rust raises errors that are no `Exception`; those of GDAL are errors of the disk, too.
    """
    if type(error).__name__ == "PanicException":
        return True
    if isinstance(error, OSError):
        return type(error).__module__.startswith("rasterio")
    return isinstance(error, Exception)


def arrays_of(path: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Arrays of an npz file by their names. Raises `OSError`, or `ValueError` for one that is damaged or has others."""
    # numpy leaves a damaged file open that it opened itself.
    with regular(path).open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as kept:
                found = [kept[name] for name in names]
            if not all(isinstance(one, np.ndarray) for one in found):
                raise TypeError("what it holds is no array")
            return found
        except OSError:
            raise
        except Exception as error:  # of the archive, of its compression, or of the headers, which numpy reads as Python
            raise ValueError(f"{type(error).__name__}: {str(error)[:200]}") from error
