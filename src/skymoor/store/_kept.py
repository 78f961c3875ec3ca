# SPDX-License-Identifier: Apache-2.0
"""Results of many large parts, such as depth maps: they stay on the disk, and are read one at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

import numpy as np

from skymoor.store._codec import decode

T = TypeVar("T")


class _File:
    """An npz that stays open from its first use on: the list of its arrays is long."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def arrays(self) -> Any:
        return np.load(self.path, allow_pickle=False)


class _From(Sequence[Any]):
    """The arrays of a file from number `first` on."""

    def __init__(self, file: _File, first: int) -> None:
        self._file, self._first = file, first

    def __len__(self) -> int:
        return len(self._file.arrays.files) - self._first

    def __getitem__(self, number: Any) -> Any:
        return self._file.arrays[str(self._first + number)]


class Kept(Sequence[T], Generic[T]):
    """Parts of a stage's result. Each access reads the part from the disk: in memory is what the caller holds.

    `entries` are those of the parts in the file: digest, number of the first array, and what `encode` made of the rest.
    """

    def __init__(self, path: Path, entries: Sequence[Any], numbers: Iterable[int] | None = None) -> None:
        self._file, self._entries = _File(path), entries
        self._numbers = list(range(len(entries)) if numbers is None else numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> list[T]: ...

    def __getitem__(self, index: int | slice) -> T | list[T]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        _, first, tree = self._entries[self._numbers[index]]
        part: T = decode(tree, _From(self._file, first))
        return part

    def take(self, index: Iterable[int]) -> Kept[T]:
        """Some of the parts; they stay on the disk."""
        some = Kept[T](self._file.path, self._entries, [self._numbers[k] for k in index])
        some._file = self._file
        return some

    def cache_key(self) -> object:
        """What results that are computed from the parts depend on: their content."""
        return [self._entries[number][0] for number in self._numbers]

    def on_disk(self) -> list[Any]:
        """What stands for the parts in the file of another stage: the name of theirs, their numbers and digests."""
        return [self._file.path.name, self._numbers, self.cache_key()]
