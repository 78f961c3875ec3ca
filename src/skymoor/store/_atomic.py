# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole or not at all, also after a crash or a power cut."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from skymoor.engines.temporary import gone_at_the_end
from skymoor.errors import InputError

PREFIX = ".skymoor-"
SUFFIX = ".tmp"


@contextmanager
def atomic_file(target: Path) -> Iterator[IO[bytes]]:
    """A binary file to write (and read back) that replaces `target` when the block ends without an error."""
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, suffix=SUFFIX, dir=target.parent)
    # A large one is written for minutes, and the process may be ended within them.
    with gone_at_the_end(Path(name)) as temporary:
        with disk_errors(target), os.fdopen(descriptor, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        with disk_errors(target):
            # mkstemp makes private files; products are ordinary ones.
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(target)
            _sync_folder(target.parent)


def atomic_folder(target: Path, fill: Callable[[Path], object]) -> None:
    """Let `fill` write into a new folder, then replace `target` by it."""
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=PREFIX, suffix=SUFFIX, dir=target.parent))
    fresh, old = temporary / "new", temporary / "old"
    with gone_at_the_end(temporary):
        with disk_errors(target):
            fresh.mkdir()
            fill(fresh)
        with disk_errors(target):
            if target.exists():
                target.rename(old)
            fresh.rename(target)
            _sync_folder(target.parent)


def atomic_files(folder: Path, names: Sequence[str], fill: Callable[[Path], object]) -> None:
    """Let `fill` write files into a new folder, then move those of `names`, in this order, into `folder`."""
    with disk_errors(folder):
        was_there = folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=PREFIX, suffix=SUFFIX, dir=folder))
    try:
        with gone_at_the_end(temporary), disk_errors(folder):
            fill(temporary)
            for name in names:
                (temporary / name).replace(folder / name)
            _sync_folder(folder)
    finally:
        if not was_there:
            with suppress(OSError):  # only an empty one goes
                folder.rmdir()


def remove_leftovers(root: Path) -> None:
    """Delete what a killed run left half-written, down to two folders below `root`, and in that of frames."""
    for pattern in ("", "*/", "*/*/", "frames/**/"):
        for path in root.glob(f"{pattern}{PREFIX}*{SUFFIX}"):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with suppress(OSError):
                    path.unlink(missing_ok=True)


@contextmanager
def disk_errors(target: Path) -> Iterator[None]:
    """Say which file the disk refused, in one line; other errors pass."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _sync_folder(folder: Path) -> None:
    """A rename is only safe from a power cut once the folder itself is on the disk."""
    if sys.platform == "win32":  # has no descriptors of folders
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
