# SPDX-License-Identifier: Apache-2.0
"""What the user asks for: a site's files, from site.toml or from the command line."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_ACCURACY, UNKNOWN_HEIGHT_SIGMA_M, checked_covariance, covariance_from_ce90_le90
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.pipeline.addressed import DSM, ORTHO, addressed
from skymoor.pipeline.option_parser import nearest, parse_option, with_options
from skymoor.pipeline.prior import KEYS, SearchPrior, prior_from_table
from skymoor.pipeline.usual_accuracy import USUAL, not_stated
from skymoor.reference.raster import MapRaster
from skymoor.sources.addresses import Addressed

__all__ = ["ReferenceFiles", "Site", "load_site", "parse_option", "site_from_arguments", "with_options"]

Array = NDArray[np.float64]

RIGHTS = ("licence", "credit", "date")
ACCURACY_KEYS = ("covariance", "ce90", "le90", "accuracy")
REFERENCE_KEYS = ("ortho", "dsm", "vertical_datum", *ACCURACY_KEYS, *RIGHTS)


@dataclass(frozen=True, eq=False)
class ReferenceFiles:
    """Orthophoto and DSM; `covariance` (3, 3) m^2 east-north-up is their absolute accuracy, or
    `UNKNOWN_ACCURACY`.

    In place of a DSM there may be one height of the ground in metres, or None where heights are not known.
    `vertical_datum` is "ellipsoid", an EPSG code, or None where the user did not say. `licence`, `credit` and `date`
    are text about both.
    """

    ortho: Path
    dsm: Path | float | None
    vertical_datum: str | None
    covariance: Array
    licence: str | None = None
    credit: str | None = None
    date: str | None = None


@dataclass(frozen=True, eq=False)
class Site:
    """What one run works on. Image names are relative to `root`; `options` are as the user wrote them in `source`.

    `airborne` is the folders and videos of the airborne photos, empty without any, `ground` those of each ground set.
    Of a reference that is `addressed` the files are below the folder of the run once they have been fetched.
    """

    name: str
    root: Path
    reference: ReferenceFiles
    airborne: tuple[Path, ...]
    ground: tuple[tuple[Path, ...], ...]
    options: dict[str, object] = field(default_factory=dict)
    source: str = "command line"
    prior: SearchPrior = field(default_factory=SearchPrior)
    addressed: Addressed | None = None

    @property
    def sets(self) -> list[tuple[str, tuple[Path, ...]]]:
        """Name and sources of each set of photos, the airborne one first."""
        air = [("airborne", self.airborne)] if self.airborne else []
        return [*air, *((f"ground{k}", sources) for k, sources in enumerate(self.ground))]

    def bounded(self, prior: SearchPrior) -> Site:
        """The same with what the search is bounded by, which overrules what the site says of it."""
        return replace(self, prior=self.prior.overruled(prior))


def load_site(
    path: Path,
    *,
    vertical_datum: str | None = None,
    ce90: float | None = None,
    le90: float | None = None,
    accuracy: str | None = None,
) -> Site:
    """Read a site.toml. Paths in it are relative to its folder; the keyword arguments overrule what it says.

    Raises `InputError`, naming the file and the key, for whatever is missing, misspelt, of the wrong type or not
    there.
    """
    table = _read_toml(path)
    where = str(path)
    _no_others(table, ("name", "reference", "airborne", "ground", "prior", "options"), where, "")
    root = path.resolve().parent
    reference = _table(table.get("reference"), where, "reference")
    _no_others(reference, REFERENCE_KEYS, where, "reference")
    ortho, dsm, sources = _sources(root, reference, where)
    if accuracy is not None:
        reference = {key: value for key, value in reference.items() if key not in ACCURACY_KEYS}
        reference["accuracy"] = accuracy
    if ce90 is not None or le90 is not None:
        covariance = _from_ce90_le90(ce90, le90, "command line", dsm, vertical_datum)
    else:
        covariance = _covariance(reference, where, dsm, vertical_datum)
    datum = vertical_datum if vertical_datum is not None else reference.get("vertical_datum")
    files = ReferenceFiles(
        ortho=ortho,
        dsm=dsm,
        vertical_datum=None if datum is None else _text(datum, where, "reference.vertical_datum"),
        covariance=covariance,
        **{key: _text(reference[key], where, f"reference.{key}") for key in RIGHTS if key in reference},
    )
    ground = table.get("ground", [])
    if not isinstance(ground, list):
        raise InputError(f"{where}: write [[ground]] with double brackets, once for each set of ground images")
    site = Site(
        name=_text(table.get("name", root.name), where, "name"),
        root=root,
        reference=files,
        airborne=_images(root, table["airborne"], where, "airborne") if "airborne" in table else (),
        ground=tuple(_images(root, entry, where, "ground") for entry in ground),
        options=_table(table.get("options", {}), where, "options"),
        source=where,
        prior=_prior(table.get("prior", {}), where),
        addressed=sources,
    )
    if not site.sets:
        raise InputError(f"{where}: there are no images; add [airborne] or [[ground]] with images = FOLDER")
    return site


def site_from_arguments(
    airborne: Sequence[Path],
    ground: Sequence[Path],
    ortho: Path | str,
    dsm: Path | str | float | None,
    vertical_datum: str | None,
    ce90: float | None,
    le90: float | None,
    accuracy: str | None = None,
) -> Site:
    """The site that the command line describes; its root is the folder that holds all the image folders.

    `ortho` is a file or an address, `dsm` too, or one height in metres, or None, which needs no `le90`. Raises
    `InputError` when a file or folder is not there, no images are given, or the accuracy is not stated.
    """
    folders = [*airborne, *ground]
    if not folders:
        raise InputError("there are no images; give --airborne FOLDER, or --ground FOLDER")
    sources = addressed(Path(), ortho, dsm)
    if sources is not None:
        ortho, dsm = ORTHO, DSM if isinstance(dsm, str | Path) else dsm
    ortho, dsm = Path(ortho), Path(dsm) if isinstance(dsm, str) else dsm
    for path, flag in ((ortho, "--ortho"), (dsm, "--dsm")):
        if sources is None and isinstance(path, Path) and not _is_there(path):
            raise InputError(f"{flag} {path}: there is no such file")
    if isinstance(dsm, float) and not np.isfinite(dsm):
        raise InputError(f"--dsm {dsm}: give a file, or the height of the ground in metres")
    for folder in folders:
        if not (_is_there(folder, folder=True) or _is_there(folder)):
            raise InputError(f"{folder}: there is no such folder of images, nor video")
    root = Path(os.path.commonpath([folder.resolve().parent for folder in folders]))
    if accuracy is not None:
        covariance = _unknown(accuracy, "--accuracy")
    else:
        covariance = _from_ce90_le90(ce90, le90, "command line", dsm, vertical_datum)
    sets = tuple((source,) for source in ground)
    files = ReferenceFiles(ortho, dsm, vertical_datum, covariance)
    return Site(root.name, root, files, tuple(airborne), sets, addressed=sources)


def _prior(table: object, where: str) -> SearchPrior:
    known = _table(table, where, "prior")
    _no_others(known, KEYS, where, "prior")
    return prior_from_table(known, where)


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


def _sources(
    root: Path, reference: Mapping[str, object], where: str
) -> tuple[Path, Path | float | None, Addressed | None]:
    """Orthophoto, DSM or height, and their addresses where they have some: then their paths are those of the run."""
    sources = addressed(root, reference.get("ortho"), reference.get("dsm"))
    if sources is None:
        return _existing(root, reference, "ortho", where, "reference"), _heights(root, reference, where), None
    return ORTHO, DSM if sources.dsm is not None else _heights(root, reference, where), sources


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


def _images(root: Path, entry: object, where: str, group: str) -> tuple[Path, ...]:
    """The folders and videos of a set."""
    table = _table(entry, where, group)
    _no_others(table, ("images",), where, group)
    if "images" not in table:
        raise InputError(f"{where}: images is missing in [{group}]; name the folder of the images")
    value = table["images"]
    listed = value if isinstance(value, list) and value else [value]
    sources = tuple(root / _text(one, where, f"{group}.images") for one in listed)
    for source in sources:
        if not (_is_there(source, folder=True) or _is_there(source)):
            raise InputError(f"{where}: {group}.images: there is no folder {source}, nor video")
    return sources


def _covariance(
    reference: Mapping[str, object], where: str, dsm: Path | float | None, vertical_datum: str | None
) -> Array:
    stated = [key for key in ("covariance", "accuracy") if key in reference]
    stated += ["ce90/le90"] if "ce90" in reference or "le90" in reference else []
    if len(stated) > 1:
        raise InputError(f"{where}: [reference] has {' and '.join(stated)}; keep one of them")
    if "accuracy" in reference:
        return _unknown(reference["accuracy"], f"{where}: reference.accuracy")
    if "covariance" in reference:
        return checked_covariance(reference["covariance"], name=f"{where}: reference.covariance")  # type: ignore[arg-type]
    ce90, le90 = (
        _number(reference[key], where, f"reference.{key}") if key in reference else None for key in ("ce90", "le90")
    )
    return _from_ce90_le90(ce90, le90, where, dsm, vertical_datum or reference.get("vertical_datum"))


def _unknown(accuracy: object, name: str) -> Array:
    if accuracy != "unknown":
        raise InputError(
            f'{name} = {accuracy!r}: the only word for it is "unknown"; else state ce90 and le90 in metres'
        )
    return UNKNOWN_ACCURACY


def _from_ce90_le90(
    ce90: float | None, le90: float | None, where: str, dsm: Path | float | None, vertical_datum: object
) -> Array:
    """The covariance (3, 3); where there are no heights, `le90` may be missing, and does not count."""
    if dsm is None:
        le90 = LE90_PER_SIGMA * UNKNOWN_HEIGHT_SIGMA_M
    if ce90 is None or le90 is None:
        missing = [name for name, value in (("ce90", ce90), ("le90", le90)) if value is None]
        # All at once, or they would be met one after the other.
        missing += ["vertical_datum"] if vertical_datum is None and not _states_datum(dsm) else []
        raise InputError(not_stated(missing, where), details=USUAL)
    if not (0 < ce90 < np.inf and 0 < le90 < np.inf):
        raise InputError(f"{where}: ce90 = {ce90} and le90 = {le90} must be metres above zero")
    return covariance_from_ce90_le90(ce90, le90)


def _states_datum(dsm: Path | float | None) -> bool:
    """Whether the file of a DSM says which vertical datum it has, or is not here to say it."""
    if not isinstance(dsm, Path) or not _is_there(dsm):
        return not isinstance(dsm, int | float)
    try:
        return MapRaster.of(dsm).vertical_datum is not None
    except InputError:  # what is wrong with it is told when it is read
        return True
