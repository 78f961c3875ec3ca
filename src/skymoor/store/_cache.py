# SPDX-License-Identifier: Apache-2.0
"""One stage's result in one file: a magic, a checksum of the rest, and the pickle of (record, value)."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path
from typing import IO, Any

from skymoor.store._atomic import atomic_file

MAGIC = b"skymoor1"
HEADER_BYTES = len(MAGIC) + hashlib.sha256().digest_size


class Corrupt(Exception):
    """The file is not what was written, or was written by code that is no longer there."""


def write_cache(file: Path, record: object, value: object) -> None:
    """Write atomically. The pickle streams to the disk, so that large results are not held twice."""
    with atomic_file(file) as out:
        out.write(bytes(HEADER_BYTES))
        pickle.dump((record, value), out, protocol=5)
        checksum = _checksum(out)
        out.seek(0)
        out.write(MAGIC + checksum)


def read_cache(file: Path) -> tuple[Any, Any]:
    """(record, value). Raises `FileNotFoundError`, or `Corrupt` for anything that cannot be trusted.

    A flipped bit in an array would unpickle without complaint, so the checksum comes first.
    """
    try:
        with file.open("rb") as stored:
            header = stored.read(HEADER_BYTES)
            if header != MAGIC + _checksum(stored):
                raise Corrupt("the checksum does not fit")
            stored.seek(HEADER_BYTES)
            record, value = pickle.load(stored)
    except FileNotFoundError:
        raise
    except (OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError, LookupError) as error:
        raise Corrupt(str(error)) from error
    except (TypeError, ValueError) as error:
        raise Corrupt(str(error)) from error
    return record, value


def _checksum(file: IO[bytes]) -> bytes:
    """SHA-256 of everything behind the header."""
    total = hashlib.sha256()
    file.seek(HEADER_BYTES)
    while block := file.read(1 << 20):
        total.update(block)
    return total.digest()
