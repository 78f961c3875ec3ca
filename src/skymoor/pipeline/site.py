# SPDX-License-Identifier: Apache-2.0
"""What the user asks for: a site's files, from site.toml or from the command line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.regular import is_there
from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_ACCURACY, UNKNOWN_HEIGHT_SIGMA_M, checked_covariance, covariance_from_ce90_le90
from skymoor.geo.accuracy import LARGEST_M, LE90_PER_SIGMA
from skymoor.pipeline.addressed import DSM, ORTHO, addressed
from skymoor.pipeline.option_parser import parse_option, with_options
from skymoor.pipeline.prior import KEYS, Person, SearchPrior, prior_from_table
from skymoor.pipeline.reference_files import RIGHTS, ReferenceFiles, earlier_run
from skymoor.pipeline.site_control import ControlFiles, control_from_table
from skymoor.pipeline.site_values import (
    Problems,
    existing,
    heights_of,
    images_of,
    known_keys,
    number_of,
    read_toml,
    rights_beside,
    site_file,
    table_of,
    text_of,
)
from skymoor.pipeline.usual_accuracy import USUAL, not_stated
from skymoor.reference.raster import MapRaster
from skymoor.sources.addresses import Addressed

__all__ = ["Site", "load_site", "parse_option", "site_from_arguments", "site_on_run", "with_options"]

Array = NDArray[np.float64]

ACCURACY_KEYS = ("covariance", "ce90", "le90", "accuracy")
REFERENCE_KEYS = ("ortho", "dsm", "run", "vertical_datum", *ACCURACY_KEYS, *RIGHTS)


@dataclass(frozen=True, eq=False)
class Site:
    """What one run works on. Image names are relative to `root`; `options` are as the user wrote them in `source`.

    `airborne` is the folders and videos of the airborne photos, empty without any, `ground` those of each ground set.
    Of a given model `airborne` are its files, and `photos` is the folder of its photos where that is not beside it.
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
    person: Person | None = None
    photos: Path | None = None
    control: ControlFiles | None = None

    @property
    def bounds(self) -> SearchPrior:
        """What the search is bounded by: what a person stated after a refusal overrules what was known before."""
        return self.prior if self.person is None else self.prior.overruled(self.person.prior)

    @property
    def sets(self) -> list[tuple[str, tuple[Path, ...]]]:
        """Name and sources of each set of photos, the airborne one first."""
        air = [("airborne", self.airborne)] if self.airborne else []
        return [*air, *((f"ground{k}", sources) for k, sources in enumerate(self.ground))]

    def bounded(self, prior: SearchPrior) -> Site:
        """The same with what the search is bounded by, which overrules what the site says of it."""
        return replace(self, prior=self.prior.overruled(prior))


NOTHING = ReferenceFiles(Path(), None, None, UNKNOWN_ACCURACY)


def load_site(
    path: Path,
    *,
    vertical_datum: str | None = None,
    ce90: float | None = None,
    le90: float | None = None,
    accuracy: str | None = None,
) -> Site:
    """Read a site.toml, or the one in a folder. Paths in it are relative to its folder; the keyword arguments overrule
    what it says.

    Raises `InputError`, naming the file and the key, for whatever is missing, misspelt, of the wrong type or not
    there: all of it at once, in `details` where it is several.
    """
    path = site_file(path)
    table, where, root = read_toml(path), str(path), path.resolve().parent
    problems = Problems(where)
    table = known_keys(table, ("name", "reference", "airborne", "ground", "prior", "control", "options"), "", problems)
    _require_no_contradiction(accuracy, ce90, le90)
    overruled = _Overruled(vertical_datum, ce90, le90, accuracy)
    site = Site(
        name=problems.value(lambda: text_of(table.get("name", root.name), where, "name"), root.name),
        root=root,
        reference=NOTHING,
        airborne=problems.value(lambda: images_of(root, table["airborne"], "airborne", problems), ())
        if "airborne" in table
        else (),
        ground=_ground(root, table.get("ground", []), problems),
        options=problems.value(lambda: table_of(table.get("options", {}), where, "options"), {}),
        source=where,
        prior=problems.value(lambda: _prior(table.get("prior", {}), problems), SearchPrior()),
        control=problems.value(lambda: control_from_table(root, table["control"], problems), None)
        if "control" in table
        else None,
    )
    with problems.collected():
        reference = known_keys(
            table_of(table.get("reference"), where, "reference"), REFERENCE_KEYS, "reference", problems
        )
        files, sources = _reference(root, reference, overruled, problems)
        site = replace(site, reference=files, addressed=sources)
    if "airborne" not in table and not table.get("ground"):
        problems.found.append(
            InputError(f"{where}: there are no images; add [airborne] or [[ground]] with images = FOLDER")
        )
    problems.raised()
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
    _require_no_contradiction(accuracy, ce90, le90)
    root = _root_of([*airborne, *ground])
    sources = addressed(Path(), ortho, dsm)
    if sources is not None:
        ortho, dsm = ORTHO, DSM if isinstance(dsm, str | Path) else dsm
    ortho, dsm = Path(ortho), Path(dsm) if isinstance(dsm, str) else dsm
    for path, flag in ((ortho, "--ortho"), (dsm, "--dsm")):
        if sources is None and isinstance(path, Path) and not is_there(path):
            raise InputError(f"{flag} {path}: there is no such file")
    if isinstance(dsm, float) and not np.isfinite(dsm):
        raise InputError(f"--dsm {dsm}: give a file, or the height of the ground in metres")
    if accuracy is not None:
        covariance = _unknown(accuracy, "--accuracy")
    else:
        covariance = _from_ce90_le90(ce90, le90, "command line", dsm, vertical_datum)
    sets = tuple((source,) for source in ground)
    files = ReferenceFiles(ortho, dsm, vertical_datum, covariance).credited(rights_beside(ortho, RIGHTS))
    return Site(root.name, root, files, tuple(airborne), sets, addressed=sources)


def site_on_run(airborne: Sequence[Path], ground: Sequence[Path], run: Path) -> Site:
    """The site of these photos whose reference is what an earlier run left in its folder. Raises `InputError`."""
    root = _root_of([*airborne, *ground])
    return Site(root.name, root, earlier_run(run), tuple(airborne), tuple((source,) for source in ground))


def _root_of(folders: Sequence[Path]) -> Path:
    """The folder that holds all folders of images."""
    if not folders:
        raise InputError("there are no images; give --airborne FOLDER, or --ground FOLDER")
    for folder in folders:
        if not (is_there(folder, folder=True) or is_there(folder)):
            raise InputError(f"{folder}: there is no such folder of images, nor video")
    return Path(os.path.commonpath([folder.resolve().parent for folder in folders]))


@dataclass(frozen=True)
class _Overruled:
    """What the command line says in place of a site.toml."""

    vertical_datum: str | None
    ce90: float | None
    le90: float | None
    accuracy: str | None


def _prior(table: object, problems: Problems) -> SearchPrior:
    known = known_keys(table_of(table, problems.where, "prior"), KEYS, "prior", problems)
    return prior_from_table(known, problems.where)


def _ground(root: Path, entries: object, problems: Problems) -> tuple[tuple[Path, ...], ...]:
    """The folders and videos of each set of ground photos."""
    if not isinstance(entries, list):
        text = f"{problems.where}: write [[ground]] with double brackets, once for each set of ground images"
        problems.found.append(InputError(text))
        return ()
    return tuple(problems.value(partial(images_of, root, entry, "ground", problems), ()) for entry in entries)


def _reference(
    root: Path, reference: Mapping[str, object], overruled: _Overruled, problems: Problems
) -> tuple[ReferenceFiles, Addressed | None]:
    """The files of the reference, and their addresses where they have some: then the paths are those of the run."""
    if "run" in reference:
        return _on_run(root, reference, overruled, problems), None
    where, unread = problems.where, root / "unread"  # stands for files that are missing, and is never returned
    sources = addressed(root, reference.get("ortho"), reference.get("dsm"))
    ortho: Path = ORTHO
    dsm: Path | float | None = DSM
    if sources is None:
        ortho = problems.value(lambda: existing(root, reference, "ortho", where, "reference"), unread)
    if sources is None or sources.dsm is None:
        dsm = problems.value(partial(heights_of, root, reference, where), unread)
    if overruled.accuracy is not None:
        reference = {key: value for key, value in reference.items() if key not in ACCURACY_KEYS}
        reference["accuracy"] = overruled.accuracy
    datum, ce90, le90 = overruled.vertical_datum, overruled.ce90, overruled.le90
    if datum is None and "vertical_datum" in reference:
        datum = problems.value(lambda: text_of(reference["vertical_datum"], where, "reference.vertical_datum"), "")
    covariance = UNKNOWN_ACCURACY
    with problems.collected():
        stated = ce90 is not None or le90 is not None
        known = (ce90, le90, "command line", dsm, datum)
        covariance = _from_ce90_le90(*known) if stated else _covariance(reference, where, dsm, datum)
    rights = {
        key: problems.value(partial(text_of, reference[key], where, f"reference.{key}"), "")
        for key in RIGHTS
        if key in reference
    }
    return ReferenceFiles(ortho, dsm, datum, covariance).credited(rights), sources


def _on_run(root: Path, reference: Mapping[str, object], overruled: _Overruled, problems: Problems) -> ReferenceFiles:
    """The products of an earlier run, which say themselves what else the table would."""
    where = problems.where
    clash = [key for key in reference if key != "run"]
    clash += [f"--{key}".replace("_", "-") for key, value in asdict(overruled).items() if value is not None]
    if clash:
        raise InputError(f"{where}: reference.run says what {' and '.join(clash)} would; keep one of them")
    return earlier_run(root / text_of(reference["run"], where, "reference.run"))


def _covariance(reference: Mapping[str, object], where: str, dsm: Path | float | None, vertical_datum: object) -> Array:
    stated = [key for key in ("covariance", "accuracy") if key in reference]
    stated += ["ce90/le90"] if "ce90" in reference or "le90" in reference else []
    if len(stated) > 1:
        raise InputError(f"{where}: [reference] has {' and '.join(stated)}; keep one of them")
    if "accuracy" in reference:
        return _unknown(reference["accuracy"], f"{where}: reference.accuracy")
    if "covariance" in reference:
        return checked_covariance(reference["covariance"], name=f"{where}: reference.covariance")  # type: ignore[arg-type]
    ce90, le90 = (
        number_of(reference[key], where, f"reference.{key}") if key in reference else None for key in ("ce90", "le90")
    )
    return _from_ce90_le90(ce90, le90, where, dsm, vertical_datum)


def _require_no_contradiction(accuracy: str | None, ce90: float | None, le90: float | None) -> None:
    if accuracy is not None and (ce90, le90) != (None, None):
        raise InputError(f"--accuracy {accuracy} says that nobody knows what --ce90 and --le90 say; leave one out")


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
    if not (0 < ce90 < LARGEST_M and 0 < le90 < LARGEST_M):
        raise InputError(f"{where}: ce90 = {ce90} and le90 = {le90} must be metres above zero, below {LARGEST_M:.0f}")
    return covariance_from_ce90_le90(ce90, le90)


def _states_datum(dsm: Path | float | None) -> bool:
    """Whether the file of a DSM says which vertical datum it has, or is not here to say it."""
    if not isinstance(dsm, Path) or not is_there(dsm):
        return not isinstance(dsm, int | float)
    try:
        return MapRaster.of(dsm).vertical_datum is not None
    except InputError:  # what is wrong with it is told when it is read
        return True
