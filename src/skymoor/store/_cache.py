# SPDX-License-Identifier: Apache-2.0
"""One stage's result in one file: an npz of its arrays and of a JSON text that says what they are, and a checksum."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.regular import regular
from skymoor.errors import InputError
from skymoor.store._atomic import atomic_file
from skymoor.store._codec import decode, encode
from skymoor.store._digest import digest
from skymoor.store._kept import Kept

R = TypeVar("R")
T = TypeVar("T")

STAGES, KEY_LENGTH = "stages", 12
"""Folder of the cache in that of a run, and how many letters of a key are part of a file's name."""
TREE = "tree"
"""Name of the JSON text among the arrays, which are called 0, 1, 2 ..."""
PARTS = "parts"
"""Stands in the JSON text where a result is read part by part."""
CHECKSUM_BYTES = hashlib.sha256().digest_size
"""Behind the npz, which readers of npz pass over: a flipped bit in an array would be read without complaint."""


class Corrupt(Exception):
    """The file is not what was written, or was written by code that is no longer there."""


def write_cache(file: Path, record: object, value: object) -> None:
    """Write atomically, one array at a time, so that large results are not held twice.

    Raises `TypeError` for a value that cannot be kept, see `encode`.
    """
    tree, arrays = encode([record, value])
    with _npz(file) as add:
        add(TREE, _text(tree))
        for k, array in enumerate(arrays):
            add(str(k), array)


def write_whole(file: Path, value: T, finished: Callable[[], R]) -> tuple[R, T]:
    """`write_cache` with the record that `finished` gives."""
    record = finished()
    write_cache(file, record, value)
    return record, value


def write_parts(file: Path, parts: Iterable[object], finished: Callable[[], R]) -> tuple[R, Kept[Any]]:
    """Write each part when it comes, so that one at a time is in memory; `finished` gives the record at the end.

    Raises as `write_cache`, and what `parts` raises.
    """
    entries: list[Any] = []
    first = 0
    coming = _Coming(parts)
    try:
        with _npz(file) as add:
            for part in coming:
                tree, arrays = encode(part)
                for k, array in enumerate(arrays):
                    add(str(first + k), array)
                entries.append([digest(part), first, tree])
                first += len(arrays)
            record = finished()
            add(TREE, _text([encode(record)[0], {PARTS: entries}]))
    except InputError:
        if coming.error is not None:  # of the work, and not of this file
            raise coming.error from None
        raise
    return record, Kept(file, entries)


class _Coming:
    """The parts, and the error of the disk that ended them."""

    def __init__(self, parts: Iterable[object]) -> None:
        self._parts = iter(parts)
        self.error: OSError | None = None

    def __iter__(self) -> Iterator[object]:
        try:
            yield from self._parts
        except OSError as error:
            self.error = error
            raise


def _text(tree: object) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(tree, allow_nan=False).encode(), np.uint8)


@contextmanager
def _npz(file: Path) -> Iterator[Callable[[str, NDArray[Any]], None]]:
    """To add arrays by name to a file, which is there whole, with its checksum, when the block ends."""
    with atomic_file(file) as out:
        with zipfile.ZipFile(out, "w") as archive:

            def add(name: str, array: NDArray[Any]) -> None:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as content:
                    np.lib.format.write_array(content, np.asanyarray(array), allow_pickle=False)

            yield add
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
        return _content(file)
    except FileNotFoundError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, MemoryError, NotImplementedError) as error:
        raise Corrupt(str(error)) from error
    except (AttributeError, ImportError, LookupError, RecursionError, SyntaxError, TypeError, ValueError) as error:
        raise Corrupt(str(error)) from error


def _content(file: Path) -> tuple[Any, Any]:
    """(record, value) of a file whose checksum fits."""
    with np.load(file, allow_pickle=False) as found:
        tree = json.loads(found[TREE].tobytes())
        if isinstance(tree[1], dict) and PARTS in tree[1]:
            entries = [(str(key), int(first), part) for key, first, part in tree[1][PARTS]]
            return decode(tree[0], []), Kept(file, entries)
        arrays = [found[str(k)] for k in range(len(found.files) - 1)]
    record, value = decode(tree, arrays, lambda reference: _referred(file.parent, *reference))
    return record, value


def _referred(folder: Path, name: str, numbers: list[int], digests: list[str]) -> Kept[Any]:
    """Parts in the file of another stage. Raises `ValueError` where they are not what was referred to."""
    if name != Path(name).name:
        raise ValueError(f"{name} is not the name of a file of a stage")
    _, parts = _content(folder / name)
    if not isinstance(parts, Kept) or (some := parts.take(numbers)).cache_key() != digests:
        raise ValueError(f"{name} holds something else")
    return some


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
