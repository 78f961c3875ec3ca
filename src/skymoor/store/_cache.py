# SPDX-License-Identifier: Apache-2.0
"""One stage's result in one file: an npz of its arrays and of a JSON text that says what they are, and a checksum."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np

from skymoor.engines.regular import regular
from skymoor.store._atomic import atomic_file
from skymoor.store._codec import decode, encode

STAGES, KEY_LENGTH = "stages", 12
"""Folder of the cache in that of a run, and how many letters of a key are part of a file's name."""
TREE = "tree"
"""Name of the JSON text among the arrays, which are called 0, 1, 2 ..."""
CHECKSUM_BYTES = hashlib.sha256().digest_size
"""Behind the npz, which readers of npz pass over: a flipped bit in an array would be read without complaint."""


class Corrupt(Exception):
    """The file is not what was written, or was written by code that is no longer there."""


def write_cache(file: Path, record: object, value: object) -> None:
    """Write atomically, one array at a time, so that large results are not held twice.

    Raises `TypeError` for a value that cannot be kept, see `encode`.
    """
    tree, arrays = encode([record, value])
    text = np.frombuffer(json.dumps(tree, allow_nan=False).encode(), np.uint8)
    with atomic_file(file) as out:
        np.savez(out, **{TREE: text}, **{str(k): array for k, array in enumerate(arrays)})  # type: ignore[arg-type]
        end = out.seek(0, 2)
        checksum = _checksum(out, end)
        out.seek(end)
        out.write(checksum)


def read_cache(file: Path) -> tuple[Any, Any]:
    """(record, value). Raises `FileNotFoundError`, or `Corrupt` for anything that cannot be trusted."""
    try:
        with regular(file).open("rb") as stored:
            end = max(0, stored.seek(0, 2) - CHECKSUM_BYTES)
            expected = _checksum(stored, end)
            stored.seek(end)
            if stored.read() != expected:
                raise Corrupt("the checksum does not fit")
            stored.seek(0)
            with np.load(stored, allow_pickle=False) as found:
                tree = json.loads(found[TREE].tobytes())
                arrays = [found[str(k)] for k in range(len(found.files) - 1)]
        record, value = decode(tree, arrays)
    except FileNotFoundError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, MemoryError, NotImplementedError) as error:
        raise Corrupt(str(error)) from error
    except (AttributeError, ImportError, LookupError, RecursionError, SyntaxError, TypeError, ValueError) as error:
        raise Corrupt(str(error)) from error
    return record, value


def read_stage(run: Path, name: str) -> Any:
    """The kept result of a stage of a run, by the stage's name, for analyses of a finished run.

    Raises `FileNotFoundError` where the run has no such stage, or its cache was cleaned; `Corrupt` if it is damaged.
    """
    kept = sorted((run / STAGES).glob(f"{name}-{'[0-9a-f]' * KEY_LENGTH}.npz"))
    if not kept:
        raise FileNotFoundError(f"{run / STAGES}: no kept result of the stage {name}; run skymoor run again")
    return read_cache(kept[-1])[1]


def _checksum(file: IO[bytes], end: int) -> bytes:
    """SHA-256 of the first `end` bytes."""
    total = hashlib.sha256()
    file.seek(0)
    while end > 0 and (block := file.read(min(end, 1 << 20))):
        total.update(block)
        end -= len(block)
    return total.digest()
