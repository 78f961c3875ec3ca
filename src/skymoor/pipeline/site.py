# SPDX-License-Identifier: Apache-2.0
"""What the user asks for: a site's files, from site.toml or from the command line."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_HEIGHT_SIGMA_M, checked_covariance, covariance_from_ce90_le90
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.pipeline.option_parser import nearest, parse_option, with_options

__all__ = ["ReferenceFiles", "Site", "load_site", "parse_option", "site_from_arguments", "with_options"]

Array = NDArray[np.float64]

STATE_ACCURACY = "the accuracy of the reference is not stated"


@dataclass(frozen=True, eq=False)
class ReferenceFiles:
    """Orthophoto and DSM; `covariance` (3, 3) m^2 east-north-up is their absolute accuracy.

    In place of a DSM there may be one height of the ground in metres, or None where heights are not known.
    `vertical_datum` is "ellipsoid", an EPSG code, or None where the user did not say.
    """

    ortho: Path
    dsm: Path | float | None
    vertical_datum: str | None
    covariance: Array


@dataclass(frozen=True, eq=False)
class Site:
    """What one run works on. Image names are relative to `root`; `options` are as the user wrote them in `source`."""

    name: str
    root: Path
    reference: ReferenceFiles
    airborne: Path | None
    ground: tuple[Path, ...]
    options: dict[str, object] = field(default_factory=dict)
    source: str = "command line"


def load_site(
    path: Path, *, vertical_datum: str | None = None, ce90: float | None = None, le90: float | None = None
) -> Site:
    """Read a site.toml. Paths in it are relative to its folder; the keyword arguments overrule what it says.

    Raises `InputError`, naming the file and the key, for whatever is missing, misspelt, of the wrong type or not
    there.
    """
    table = _read_toml(path)
    where = str(path)
    _no_others(table, ("name", "reference", "airborne", "ground", "options"), where, "")
    root = path.resolve().parent
    reference = _table(table.get("reference"), where, "reference")
    _no_others(reference, ("ortho", "dsm", "vertical_datum", "covariance", "ce90", "le90"), where, "reference")
    dsm = _heights(root, reference, where)
    if ce90 is not None or le90 is not None:
        covariance = _from_ce90_le90(ce90, le90, "command line", heights=dsm is not None)
    else:
        covariance = _covariance(reference, where, heights=dsm is not None)
    datum = vertical_datum if vertical_datum is not None else reference.get("vertical_datum")
    files = ReferenceFiles(
        ortho=_existing(root, reference, "ortho", where, "reference"),
        dsm=dsm,
        vertical_datum=None if datum is None else _text(datum, where, "reference.vertical_datum"),
        covariance=covariance,
    )
    ground = table.get("ground", [])
    if not isinstance(ground, list):
        raise InputError(f"{where}: write [[ground]] with double brackets, once for each set of ground images")
    site = Site(
        name=_text(table.get("name", root.name), where, "name"),
        root=root,
        reference=files,
        airborne=_images(root, table["airborne"], where, "airborne") if "airborne" in table else None,
        ground=tuple(_images(root, entry, where, "ground") for entry in ground),
        options=_table(table.get("options", {}), where, "options"),
        source=where,
    )
    if site.airborne is None and not site.ground:
        raise InputError(f"{where}: there are no images; add [airborne] with images = FOLDER")
    return site


def site_from_arguments(
    airborne: Path | None,
    ground: Sequence[Path],
    ortho: Path,
    dsm: Path | float | None,
    vertical_datum: str | None,
    ce90: float | None,
    le90: float | None,
) -> Site:
    """The site that the command line describes; its root is the folder that holds all the image folders.

    `dsm` is a file, one height in metres, or None, which needs no `le90`. Raises `InputError` when a file or folder is
    not there, no images are given, or the accuracy is not stated.
    """
    folders = [folder for folder in (airborne, *ground) if folder is not None]
    if not folders:
        raise InputError("there are no images; give --airborne FOLDER")
    for path, flag in ((ortho, "--ortho"), (dsm, "--dsm")):
        if isinstance(path, Path) and not _is_there(path):
            raise InputError(f"{flag} {path}: there is no such file")
    if isinstance(dsm, float) and not np.isfinite(dsm):
        raise InputError(f"--dsm {dsm}: give a file, or the height of the ground in metres")
    for folder in folders:
        if not _is_there(folder, folder=True):
            raise InputError(f"{folder}: there is no such folder of images")
    root = Path(os.path.commonpath([folder.resolve().parent for folder in folders]))
    covariance = _from_ce90_le90(ce90, le90, "command line", heights=dsm is not None)
    return Site(root.name, root, ReferenceFiles(ortho, dsm, vertical_datum, covariance), airborne, tuple(ground))


def _read_toml(path: Path) -> dict[str, object]:
    if _is_there(path, folder=True):
        raise InputError(f"{path}: is a folder; give the site.toml in it")
    try:
        # utf-8-sig: editors of Windows put a byte order mark in front.
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except RecursionError:
        raise InputError(f"{path}: is not valid TOML: brackets within brackets without end") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # of the decoder, of the letters, and of numbers with thousands of digits
        raise InputError(f"{path}: is not valid TOML: {error}") from error


def _table(value: object, where: str, key: str) -> dict[str, object]:
    if value is None:
        raise InputError(f"{where}: the table [{key}] is missing")
    if not isinstance(value, dict):
        raise InputError(f"{where}: {key} must be a table: write [{key}] on a line of its own")
    return value


def _no_others(table: Mapping[str, object], known: Sequence[str], where: str, group: str) -> None:
    for key in table:
        if key not in known:
            inside = f" in [{group}]" if group else ""
            raise InputError(f"{where}: unknown key {key}{inside}; {nearest(key, known)}")


def _text(value: object, where: str, key: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{where}: {key} = {value!r} must be text in quotes")
    return value


def _number(value: object, where: str, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{where}: {key} = {value!r} must be a number of metres")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {key} is too large for a number of metres") from None


def _is_there(path: Path, *, folder: bool = False) -> bool:
    """Whether there is such a file, or folder; False also for names that no file can have."""
    try:
        return path.is_dir() if folder else path.is_file()
    except (OSError, ValueError):
        return False


def _existing(root: Path, table: Mapping[str, object], key: str, where: str, group: str) -> Path:
    if key not in table:
        raise InputError(f"{where}: {key} is missing in [{group}]")
    path = root / _text(table[key], where, f"{group}.{key}")
    if not _is_there(path):
        raise InputError(f"{where}: {group}.{key}: there is no file {path}")
    return path


def _heights(root: Path, reference: Mapping[str, object], where: str) -> Path | float | None:
    """The file of the DSM, one height in metres, or None where the key is missing."""
    value = reference.get("dsm")
    if value is None or isinstance(value, str):
        return None if value is None else _existing(root, reference, "dsm", where, "reference")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: reference.dsm = {value!r} must be a file in quotes, or a height in metres")
    height = _number(value, where, "reference.dsm")
    if not np.isfinite(height):
        raise InputError(f"{where}: reference.dsm = {value!r} must be a height in metres")
    return height


def _images(root: Path, entry: object, where: str, group: str) -> Path:
    table = _table(entry, where, group)
    _no_others(table, ("images",), where, group)
    if "images" not in table:
        raise InputError(f"{where}: images is missing in [{group}]; name the folder of the images")
    folder = root / _text(table["images"], where, f"{group}.images")
    if not _is_there(folder, folder=True):
        raise InputError(f"{where}: {group}.images: there is no folder {folder}")
    return folder


def _covariance(reference: Mapping[str, object], where: str, *, heights: bool) -> Array:
    has_figures = "ce90" in reference or "le90" in reference
    if "covariance" in reference and has_figures:
        raise InputError(f"{where}: [reference] has covariance and ce90/le90; keep one of them")
    if "covariance" not in reference:
        figures = [
            _number(reference[key], where, f"reference.{key}") if key in reference else None for key in ("ce90", "le90")
        ]
        return _from_ce90_le90(figures[0], figures[1], where, heights=heights)
    return checked_covariance(reference["covariance"], name=f"{where}: reference.covariance")  # type: ignore[arg-type]


def _from_ce90_le90(ce90: float | None, le90: float | None, where: str, *, heights: bool) -> Array:
    """The covariance (3, 3); where there are no heights, `le90` may be missing, and does not count."""
    if not heights:
        le90 = LE90_PER_SIGMA * UNKNOWN_HEIGHT_SIGMA_M
    if ce90 is None or le90 is None:
        missing = " and ".join(name for name, value in (("ce90", ce90), ("le90", le90)) if value is None)
        remedy = "give --ce90 M --le90 M" if where == "command line" else "write ce90 = M and le90 = M in [reference]"
        raise InputError(f"{where}: {STATE_ACCURACY}: {missing} missing; {remedy}, in metres")
    if not (0 < ce90 < np.inf and 0 < le90 < np.inf):
        raise InputError(f"{where}: ce90 = {ce90} and le90 = {le90} must be metres above zero")
    return covariance_from_ce90_le90(ce90, le90)
