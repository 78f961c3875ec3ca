# SPDX-License-Identifier: Apache-2.0
"""Stable hashes of options and of source code, the same in every process and on every machine."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import ModuleType

import numpy as np


def digest(value: object) -> str:
    """SHA-256, in hexadecimal, of plain values, numpy arrays, paths, enums, dataclasses and containers of them.

    The type counts: 1, 1.0 and True differ, and so do two dataclasses with equal fields, since each may be another
    engine. Raises `TypeError` for anything whose text is not stable, such as a function.
    """
    return hashlib.sha256(_encoded(value)).hexdigest()


def code_fingerprint(code: Sequence[ModuleType | str]) -> str:
    """SHA-256 of the source text of modules, and of all modules below those that are packages."""
    parts: list[tuple[str, str]] = []
    for entry in code:
        name = entry if isinstance(entry, str) else entry.__name__
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            raise ValueError(f"module {name} has no source")
        origin = Path(spec.origin)
        base = origin.parent
        files = sorted(base.rglob("*.py")) if spec.submodule_search_locations else [origin]
        parts += [
            (f"{name}:{file.relative_to(base).as_posix()}", hashlib.sha256(file.read_bytes()).hexdigest())
            for file in files
        ]
    return digest(sorted(parts))


def _encoded(value: object) -> bytes:
    """A tag for the type, then the content; containers hold digests of fixed length, so nothing can run together."""
    if isinstance(value, Enum):
        return b"enum:" + f"{type(value).__qualname__}.{value.name}".encode()
    if value is None or isinstance(value, (bool, int, float, str)):
        return f"{type(value).__name__}:{value!r}".encode()
    if isinstance(value, bytes):
        return b"bytes:" + value
    if isinstance(value, Path):
        return b"path:" + value.as_posix().encode()
    if isinstance(value, (np.ndarray, np.generic)):
        return _encoded_array(np.asarray(value))
    if is_dataclass(value) and not isinstance(value, type):
        pairs = [(item.name, digest(getattr(value, item.name))) for item in fields(value)]
        return f"dataclass:{type(value).__module__}.{type(value).__qualname__}:{pairs}".encode()
    if isinstance(value, Mapping):
        return f"mapping:{sorted((digest(key), digest(item)) for key, item in value.items())}".encode()
    if isinstance(value, AbstractSet):
        return f"set:{sorted(digest(item) for item in value)}".encode()
    if isinstance(value, (list, tuple)):
        return f"sequence:{[digest(item) for item in value]}".encode()
    raise TypeError(f"{type(value).__qualname__} has no stable hash; give its settings instead")


def _encoded_array(array: np.ndarray) -> bytes:
    if array.dtype.hasobject:
        raise TypeError("an array of objects has no stable hash")
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return f"array:{little.dtype.str}:{array.shape}:".encode() + np.ascontiguousarray(little).tobytes()
