# SPDX-License-Identifier: Apache-2.0
"""Stable hashes of values, the same in every process and on every machine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from skymoor.store._codec import OnDisk, is_tensor, tensor_array

_KNOWN: WeakKeyDictionary[Any, str] = WeakKeyDictionary()
"""Digests of dataclasses that compare by identity: large results are hashed once, though several stages take them."""


def digest(value: object, of_file: Callable[[Path], str] | None = None) -> str:
    """SHA-256, in hexadecimal, of plain values, arrays, paths, enums, dataclasses and containers of them.

    The type counts: 1, 1.0 and True differ, and so do two dataclasses with equal fields, since each may be another
    engine. An object with a method `cache_key` is what that returns, one with `to_state` is its state. `of_file` says
    what a path stands for; by itself without it. Raises `TypeError` for anything whose text is not stable, such as a
    function.
    """
    if _by_identity(value):
        if value not in _KNOWN:
            _KNOWN[value] = hashlib.sha256(_encoded(value, of_file)).hexdigest()
        return _KNOWN[value]
    return hashlib.sha256(_encoded(value, of_file)).hexdigest()


def parts_of(value: object) -> Iterator[object]:
    """A value and all objects of our own in it, as the elements of lists and the fields of dataclasses."""
    if isinstance(value, (list, tuple, AbstractSet)):
        for item in value:
            yield from parts_of(item)
    elif isinstance(value, OnDisk):
        yield from parts_of(next(iter(value), None))  # type: ignore[call-overload]  # all are of one type
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from parts_of(item)
    elif is_dataclass(value) and not isinstance(value, type):
        yield value
        for field in fields(value):
            yield from parts_of(getattr(value, field.name))
    elif hasattr(value, "to_state") or hasattr(value, "cache_key"):
        yield value


def _by_identity(value: object) -> bool:
    return is_dataclass(value) and not isinstance(value, type) and type(value).__hash__ is object.__hash__


def _encoded(value: object, of_file: Callable[[Path], str] | None) -> bytes:
    """A tag for the type, then the content; containers hold digests of fixed length, so nothing can run together."""

    def inner(item: object) -> str:
        return digest(item, of_file)

    if isinstance(value, Enum):
        return b"enum:" + f"{type(value).__qualname__}.{value.name}".encode()
    if value is None or isinstance(value, (bool, int, float, str)):
        return f"{type(value).__name__}:{value!r}".encode()
    if isinstance(value, bytes):
        return b"bytes:" + value
    if isinstance(value, Path):
        return b"path:" + (value.as_posix() if of_file is None else of_file(value)).encode()
    if isinstance(value, (np.ndarray, np.generic)):
        return _encoded_array(np.asarray(value))
    if is_tensor(value):
        return b"tensor:" + _encoded_array(tensor_array(value))
    if isinstance(value, np.random.Generator):
        return f"generator:{inner(value.bit_generator.state)}".encode()
    kind = f"{type(value).__module__}.{type(value).__qualname__}"
    if hasattr(value, "cache_key"):
        return f"object:{kind}:{inner(value.cache_key())}".encode()
    if hasattr(value, "to_state"):
        return f"object:{kind}:{inner(value.to_state())}".encode()
    if is_dataclass(value) and not isinstance(value, type):
        pairs = [(item.name, inner(getattr(value, item.name))) for item in fields(value)]
        return f"dataclass:{kind}:{pairs}".encode()
    if isinstance(value, Mapping):
        return f"mapping:{sorted((inner(key), inner(item)) for key, item in value.items())}".encode()
    if isinstance(value, AbstractSet):
        return f"set:{sorted(inner(item) for item in value)}".encode()
    if isinstance(value, (list, tuple)):
        return f"sequence:{[inner(item) for item in value]}".encode()
    raise TypeError(f"{type(value).__qualname__} has no stable hash; give its settings instead")


def _encoded_array(array: np.ndarray) -> bytes:
    if array.dtype.hasobject:
        raise TypeError("an array of objects has no stable hash")
    little = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<"), copy=False))
    content = hashlib.sha256(little.data.cast("B") if little.size else b"").hexdigest()
    return f"array:{little.dtype.str}:{array.shape}:{content}".encode()
