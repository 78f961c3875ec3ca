# SPDX-License-Identifier: Apache-2.0
"""Values of a site.toml, checked one by one; what is wrong with several of them is told at once."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from skymoor.engines.regular import is_there, regular
from skymoor.errors import InputError
from skymoor.pipeline.option_parser import close_to, nearest
from skymoor.sources.fragment import TABLE

T = TypeVar("T")
S = TypeVar("S")

SITE_FILE = "site.toml"


@dataclass
class Problems:
    """Collects what is wrong in the file `where`, so that a user meets all of it at once."""

    where: str
    found: list[InputError] = field(default_factory=list)

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Keep an `InputError` of the block, and go on after it."""
        try:
            yield
        except InputError as error:
            self.found.append(error)

    def value(self, make: Callable[[], T], otherwise: S) -> T | S:
        """What `make` returns; `otherwise`, which nobody will see, where it raises `InputError`."""
        try:
            return make()
        except InputError as error:
            self.found.append(error)
            return otherwise

    def raised(self) -> None:
        """Raise the one problem as it is, or several as one `InputError` with a line for each."""
        if len(self.found) == 1:
            raise self.found[0]
        if self.found:
            lines = [f"  {str(one).removeprefix(f'{self.where}: ')}" for one in self.found]
            tables = [line for one in self.found for line in one.details]
            raise InputError(f"{self.where}: {len(self.found)} problems", details=[*lines, *tables])


def read_toml(path: Path) -> dict[str, object]:
    """The content of a TOML file. Raises `InputError`."""
    try:
        # utf-8-sig: editors of Windows put a byte order mark in front.
        return tomllib.loads(regular(path).read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except RecursionError:
        raise InputError(f"{path}: is not valid TOML: brackets within brackets without end") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # of the decoder, of the letters, and of numbers with thousands of digits
        raise InputError(f"{path}: is not valid TOML: {error}") from error


def rights_beside(ortho: Path, keys: Sequence[str]) -> dict[str, str]:
    """Licence, credit and date of an orthophoto that `skymoor reference` fetched, from the table beside it.

    Nothing else is taken from there: a datum or an accuracy is stated by who runs it.
    """
    table = ortho.with_name(TABLE)
    try:
        fetched = read_toml(table).get("reference")
    except InputError:  # nothing beside it, or another program's file
        return {}
    if not isinstance(fetched, dict) or fetched.get("ortho") != ortho.name:
        return {}
    return {key: fetched[key] for key in keys if isinstance(fetched.get(key), str)}


def site_file(path: Path) -> Path:
    """The file of a site that is named by it or by its folder. Raises `InputError` for a folder without one."""
    if not is_there(path, folder=True):
        return path
    if is_there(path / SITE_FILE):
        return path / SITE_FILE
    raise InputError(
        f"{path}: is a folder without {SITE_FILE}; if it holds photos, name it with --airborne {path}, or let "
        f"skymoor init {path} --ortho FILE write one"
    )


def known_keys(table: Mapping[str, object], known: Sequence[str], group: str, problems: Problems) -> dict[str, object]:
    """The table with each unknown key noted as a problem.

    A misspelt key stands for the nearest one that is missing, so that this one is not told to be missing as well.
    """
    right = {key: value for key, value in table.items() if key in known}
    for key, value in table.items():
        if key not in known:
            inside = f" in [{group}]" if group else ""
            error = InputError(f"{problems.where}: unknown key {key}{inside}; {nearest(key, known)}")
            problems.found.append(error)
            meant = next((name for name in close_to(key, known) if name not in table), None)
            if meant is not None:
                right[meant] = value
    return right


def table_of(value: object, where: str, key: str) -> dict[str, object]:
    """A table. Raises `InputError` for what is none, or missing."""
    if value is None:
        raise InputError(f"{where}: the table [{key}] is missing")
    if not isinstance(value, dict):
        raise InputError(f"{where}: {key} must be a table: write [{key}] on a line of its own")
    return value


def text_of(value: object, where: str, key: str) -> str:
    """Text that is not blank, or `InputError`."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{where}: {key} = {value!r} must be text in quotes")
    return value


def number_of(value: object, where: str, key: str) -> float:
    """A number of metres, or `InputError`."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{where}: {key} = {value!r} must be a number of metres")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {key} is too large for a number of metres") from None


def existing(root: Path, table: Mapping[str, object], key: str, where: str, group: str) -> Path:
    """The file that a key names, relative to `root`. Raises `InputError`."""
    if key not in table:
        raise InputError(f"{where}: {key} is missing in [{group}]")
    path = root / text_of(table[key], where, f"{group}.{key}")
    if not is_there(path):
        raise InputError(f"{where}: {group}.{key}: there is no file {path}")
    return path


def heights_of(root: Path, reference: Mapping[str, object], where: str) -> Path | float | None:
    """The file of the DSM, one height in metres, or None where the key is missing."""
    value = reference.get("dsm")
    if value is None or isinstance(value, str):
        return None if value is None else existing(root, reference, "dsm", where, "reference")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: reference.dsm = {value!r} must be a file in quotes, or a height in metres")
    height = number_of(value, where, "reference.dsm")
    if not np.isfinite(height):
        raise InputError(f"{where}: reference.dsm = {value!r} must be a height in metres")
    return height


def images_of(root: Path, entry: object, group: str, problems: Problems) -> tuple[Path, ...]:
    """The folders and videos of a set. Raises `InputError`; what is wrong with a key is noted."""
    where = problems.where
    table = known_keys(table_of(entry, where, group), ("images",), group, problems)
    if "images" not in table:
        raise InputError(f"{where}: images is missing in [{group}]; name the folder of the images")
    value = table["images"]
    listed = value if isinstance(value, list) and value else [value]
    sources = tuple(root / text_of(one, where, f"{group}.images") for one in listed)
    for source in sources:
        with problems.collected():
            if not (is_there(source, folder=True) or is_there(source)):
                raise InputError(f"{where}: {group}.images: there is no folder {source}, nor video")
    return sources
