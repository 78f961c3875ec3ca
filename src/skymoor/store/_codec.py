# SPDX-License-Identifier: Apache-2.0
"""Results of stages as JSON and arrays: nothing that is read back can run code.

A dataclass is its class's name and its fields; an array is a number in a list of arrays. Only dataclasses of this
package, and classes of it with `to_state` and `from_state`, are made when a file is read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

PACKAGE = "skymoor"


@runtime_checkable
class Stateful(Protocol):
    """An object that is no dataclass, as a network: it is kept as its state."""

    def to_state(self) -> dict[str, Any]:
        """What the object can be made of again: plain values, arrays and dataclasses."""

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Self:
        """The object of a state."""


@runtime_checkable
class OnDisk(Protocol):
    """A sequence whose items stay in the file of their stage: other files refer to it."""

    def on_disk(self) -> list[Any]:
        """Plain values by which the sequence is found again."""


def _no_other_files(_: Any) -> object:
    raise ValueError("no other file is read here")


def encode(value: object) -> tuple[Any, list[NDArray[Any]]]:
    """(JSON value, arrays) of plain values, arrays, dataclasses of this package and containers of them.

    Raises `TypeError` for anything else.
    """
    arrays: list[NDArray[Any]] = []
    numbers: dict[int, int] = {}
    return _encoded(value, arrays, numbers), arrays


def decode(tree: Any, arrays: Sequence[NDArray[Any]], referred: Callable[[Any], object] = _no_other_files) -> Any:
    """What `encode` was given; `referred` gives a sequence by its reference.

    Raises `ValueError`, `TypeError` or `LookupError` for what `encode` never wrote.
    """

    def inner(item: Any) -> Any:
        return decode(item, arrays, referred)

    if isinstance(tree, list):
        return [inner(item) for item in tree]
    if not isinstance(tree, dict):
        return tree
    ((tag, content),) = tree.items()
    if tag == "object":
        name, state = content
        return _made(name, {key: inner(item) for key, item in state.items()})
    if tag == "array":
        return arrays[content]
    if tag == "tensor":
        return import_module("torch").from_numpy(arrays[content])
    if tag == "kept":
        return referred(content)
    return _plain(tag, content, inner)


def is_tensor(value: object) -> bool:
    """Whether a value is a tensor of PyTorch, which need not be installed."""
    return type(value).__module__.partition(".")[0] == "torch" and hasattr(value, "detach")


def tensor_array(tensor: Any) -> NDArray[Any]:
    """The content of a tensor, in main memory."""
    return np.asarray(tensor.detach().cpu().numpy())


def _encoded(value: Any, arrays: list[NDArray[Any]], numbers: dict[int, int]) -> Any:
    def inner(item: object) -> Any:
        return _encoded(item, arrays, numbers)

    if isinstance(value, np.generic):
        return {"scalar": [value.dtype.str, _number(value.item())]}
    if isinstance(value, float):
        return _number(value)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, np.ndarray):
        return {"array": _numbered(value, value, arrays, numbers)}
    if is_tensor(value):
        return {"tensor": _numbered(value, tensor_array(value), arrays, numbers)}
    if isinstance(value, list):
        return [inner(item) for item in value]
    if isinstance(value, tuple):
        return {"tuple": [inner(item) for item in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[inner(key), inner(item)] for key, item in value.items()]}
    if isinstance(value, OnDisk):
        return {"kept": value.on_disk()}
    if isinstance(value, Path):
        return {"path": value.as_posix()}
    kind = type(value)
    if kind.__module__.partition(".")[0] == PACKAGE:
        name = f"{kind.__module__}:{kind.__qualname__}"
        if isinstance(value, Stateful):
            return {"object": [name, {key: inner(item) for key, item in value.to_state().items()}]}
        if is_dataclass(value) and not isinstance(value, type):
            content = {item.name: inner(getattr(value, item.name)) for item in fields(value) if item.init}
            return {"object": [name, content]}
    raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be kept in the cache")


def _numbered(value: object, array: NDArray[Any], arrays: list[NDArray[Any]], numbers: dict[int, int]) -> int:
    """The number of an array; one that occurs twice is kept once."""
    if array.dtype.hasobject:
        raise TypeError("an array of objects cannot be kept in the cache")
    if id(value) not in numbers:
        numbers[id(value)] = len(arrays)
        arrays.append(array)
    return numbers[id(value)]


def _number(value: Any) -> Any:
    """JSON knows no infinity and no NaN."""
    return {"float": repr(value)} if isinstance(value, float) and not np.isfinite(value) else value


def _plain(tag: str, content: Any, inner: Callable[[Any], Any]) -> Any:
    if tag == "float":
        return float(content)
    if tag == "path":
        return Path(content)
    if tag == "scalar":
        return np.dtype(content[0]).type(inner(content[1]))
    if tag == "tuple":
        return tuple(inner(item) for item in content)
    if tag == "mapping":
        return {inner(key): inner(item) for key, item in content}
    raise ValueError(f"{tag!r} is not a kind of value")


def _made(name: str, state: dict[str, Any]) -> Any:
    """An object of a class of this package, which nothing but its fields or its state makes."""
    module, _, path = name.partition(":")
    if module.partition(".")[0] != PACKAGE:
        raise ValueError(f"{name} is not a class of {PACKAGE}")
    kind: Any = import_module(module)
    for part in path.split("."):
        kind = vars(kind)[part]
    if isinstance(kind, type) and issubclass(kind, Stateful):
        return kind.from_state(state)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise ValueError(f"{name} is not a dataclass")
    return kind(**state)
