# SPDX-License-Identifier: Apache-2.0
"""The control of a site: the table [control] of a site.toml, and the arguments of the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

from skymoor.control import Control
from skymoor.engines.regular import is_there
from skymoor.errors import InputError
from skymoor.pipeline.control_files import read_control
from skymoor.pipeline.control_places import Stated, crs_of
from skymoor.pipeline.site_values import Problems, known_keys, number_of, table_of, text_of

KEYS = ("files", "use", "crs", "vertical_datum", "ce90", "le90")


@dataclass(frozen=True)
class ControlFiles:
    """Files of control, what is stated of them, and whether models are moved onto it; `given` is what they say."""

    files: tuple[Path, ...]
    stated: Stated
    use: bool = False
    given: Control | None = None

    def read(self) -> ControlFiles:
        """With what the files say. Raises `InputError`."""
        return replace(self, given=read_control(self.files, self.stated, use=self.use))


def control_from_table(root: Path, value: object, problems: Problems) -> ControlFiles:
    """Of the table [control] of a site.toml. Raises `InputError`; unknown keys are noted."""
    where = problems.where
    table = known_keys(table_of(value, where, "control"), KEYS, "control", problems)
    if "files" not in table:
        raise InputError(f"{where}: files is missing in [control]; name the file of points, positions or scale bars")
    listed = table["files"] if isinstance(table["files"], list) else [table["files"]]
    files = tuple(root / text_of(one, where, "control.files") for one in listed)
    for file in files:
        if not is_there(file):
            raise InputError(f"{where}: control.files: there is no file {file}")
    use = table.get("use", False)
    if not isinstance(use, bool):
        raise InputError(f"{where}: control.use = {use!r} must be true or false")
    texts = {key: text_of(table[key], where, f"control.{key}") for key in ("crs", "vertical_datum") if key in table}
    numbers = {
        key: _metres(number_of(table[key], where, f"control.{key}"), f"{where}: control.{key}")
        for key in ("ce90", "le90")
        if key in table
    }
    if "crs" in texts:
        texts["crs"] = crs_of(texts["crs"], f"{where}: control.crs")
    return ControlFiles(files, Stated(**texts, **numbers), use).read()  # type: ignore[arg-type]


def control_with_arguments(
    control: ControlFiles | None,
    files: Sequence[Path],
    ce90: float | None,
    le90: float | None,
    vertical_datum: str | None,
    *,
    use: bool,
) -> ControlFiles | None:
    """The control of a site with what the command line adds or overrules. Raises `InputError`."""
    numbers = {"ce90": ce90, "le90": le90}
    given = {
        **{name: _metres(value, f"--control-{name}") for name, value in numbers.items() if value is not None},
        **({} if vertical_datum is None else {"vertical_datum": vertical_datum}),
    }
    if not files and not given and not use:
        return control
    if control is None and not files:
        raise InputError("there is no control; give --control FILE with its points, positions or scale bars")
    known = control or ControlFiles((), Stated())
    stated = replace(known.stated, **given)  # type: ignore[arg-type]
    return ControlFiles((*known.files, *files), stated, known.use or use).read()


def plain_control(control: ControlFiles | None) -> dict[str, Any] | None:
    """For summary.json."""
    if control is None:
        return None
    return {"files": [path.resolve() for path in control.files], "use": control.use, **vars(control.stated)}


def control_from_plain(value: Mapping[str, Any] | None) -> ControlFiles | None:
    """The inverse; the files are read again. Raises `InputError`, `KeyError` or `TypeError` for anything else."""
    if value is None:
        return None
    stated = Stated(**{key: value[key] for key in ("crs", "vertical_datum", "ce90", "le90")})
    return ControlFiles(tuple(Path(one) for one in value["files"]), stated, value["use"]).read()


def _metres(value: float, name: str) -> float:
    if not (isfinite(value) and value > 0):
        raise InputError(f"{name} = {value:g} must be metres above zero")
    return value
