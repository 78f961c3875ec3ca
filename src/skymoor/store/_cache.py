# SPDX-License-Identifier: Apache-2.0
"""One stage's result in one file: an npz of its arrays and of a JSON text that says what they are."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.store._atomic import atomic_file
from skymoor.store._codec import decode, encode

TREE = "tree"
"""Name of the JSON text among the arrays, which are called 0, 1, 2 ..."""


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


def read_cache(file: Path) -> tuple[Any, Any]:
    """(record, value). Raises `FileNotFoundError`, or `Corrupt` for anything that cannot be trusted.

    The archive has a checksum of each array, which is compared as it is read: a flipped bit does not pass.
    """
    try:
        with np.load(file, allow_pickle=False) as stored:
            tree = json.loads(stored[TREE].tobytes())
            arrays = [stored[str(k)] for k in range(len(stored.files) - 1)]
        record, value = decode(tree, arrays)
    except FileNotFoundError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, MemoryError, NotImplementedError) as error:
        raise Corrupt(str(error)) from error
    except (AttributeError, ImportError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise Corrupt(str(error)) from error
    return record, value
