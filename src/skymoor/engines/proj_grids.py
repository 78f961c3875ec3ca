# SPDX-License-Identifier: Apache-2.0
"""PROJ's grids of geoids and datum shifts: which are here, which a datum needs, and fetching one from PROJ's server."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.datadir import get_user_data_dir  # type: ignore[attr-defined]
from pyproj.exceptions import CRSError
from pyproj.sync import get_proj_endpoint, get_transform_grid_list  # type: ignore[attr-defined]

from skymoor.engines.download import Fetched, FileProgress, download
from skymoor.errors import InputError
from skymoor.geo.operations import grid_file, operations_between

# Of references that are common; `skymoor grids fetch` knows all others of PROJ too.
COMMON = (
    *("EPSG:3855", "EPSG:5773", "EPSG:5703", "EPSG:7837", "EPSG:5720", "EPSG:5711", "EPSG:6647"),
    *("EPSG:27700", "EPSG:4267", "EPSG:31467"),
)
CATALOGUE = "files.geojson"
MOST_LISTED = 12


@dataclass(frozen=True)
class DatumGrids:
    """A vertical datum, or a horizontal CRS, and the grids of which one takes it to WGS 84.

    `grids` are the names of files and where they are valid; `here` are those of them that are installed.
    """

    code: str
    name: str
    grids: tuple[tuple[str, str], ...]
    here: tuple[str, ...]


def user_folder() -> Path:
    """Where PROJ looks for grids of this user."""
    return Path(get_user_data_dir())


def grids_of(datum: str) -> DatumGrids:
    """The grids of a datum that PROJ offers for download, those first that it would choose.

    Raises `InputError` for what is no vertical datum and no CRS.
    """
    try:
        crs = CRS.from_user_input(datum)
    except CRSError:
        raise InputError(
            f"{datum}: neither a grid nor a datum; give a file such as us_nga_egm08_25.tif, or EPSG:CODE"
        ) from None
    vertical = crs.is_vertical and not crs.is_compound
    source: Any = CompoundCRS("any", [CRS("EPSG:4326"), crs]) if vertical else crs.to_3d() if crs.is_compound else crs
    group = operations_between(source, CRS("EPSG:4979" if len(CRS(source).axis_info) == 3 else "EPSG:4326"), None)
    found: dict[str, str] = {}
    operations: list[Any] = [*group.transformers, *group.unavailable_operations]
    for operation in operations:
        steps = operation.operations or (operation,)  # what is not available has no steps
        grids = [grid for step in steps for grid in step.grids]
        if len(grids) == 1 and grids[0].url:
            found.setdefault(grids[0].short_name, _area(operation))
    return DatumGrids(datum, crs.name, tuple(found.items()), tuple(name for name in found if grid_file(name)))


def fetch_grid(wanted: str, progress: Callable[[str], FileProgress]) -> Fetched:
    """Download a grid by the name of its file, or by the code of a datum that has one grid, such as "EPSG:3855".

    It goes to pyproj's folder of the user, where PROJ finds it, and is checked by the digest of PROJ's catalogue; what
    is here already is left alone.

    Raises `InputError` when there is no such grid, a datum has several, or the download fails.
    """
    name = _only_grid(wanted) if ":" in wanted else wanted if "." in wanted else f"{wanted}.tif"
    there = grid_file(name)
    if there is not None:
        return Fetched(there, None, was_there=True)
    folder = user_folder()
    path, by_hand = folder / name, f"put the file into {folder} by hand"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        facts = _facts(name, folder, by_hand)
        digest, size_mb = facts["sha256sum"], float(facts.get("file_size") or 0) / 1e6
        url, show = f"{get_proj_endpoint()}/{name}", progress(name)
        download(url, path, sha256=digest, size_mb=size_mb, progress=show, by_hand=by_hand)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); PROJ looks for grids there") from error
    return Fetched(path, digest, was_there=False)


def _area(operation: Any) -> str:
    """Where an operation is valid, without the lists of states."""
    name = operation.area_of_use.name if operation.area_of_use else ""
    return " - ".join(name.split(" - ")[:2]).split(";")[0].rstrip(".")


def _only_grid(datum: str) -> str:
    found = grids_of(datum)
    names = [name for name, _ in found.grids]
    if not names:
        raise InputError(f"{datum} ({found.name}): PROJ needs no grid for it, or offers none for download")
    if len(names) > 1:
        listed = "; ".join(f"{name} ({area})" for name, area in found.grids[:MOST_LISTED])
        raise InputError(f"{datum} ({found.name}) has several grids, fetch that of your site by its name: {listed}")
    return names[0]


def _facts(name: str, folder: Path, by_hand: str) -> dict[str, Any]:
    """What PROJ's catalogue says about a grid, such as its digest and size."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        path = Path(temporary) / CATALOGUE
        url = f"{get_proj_endpoint()}/{CATALOGUE}"
        download(url, path, by_hand=by_hand)
        try:
            listed = get_transform_grid_list(filename=name, include_already_downloaded=True, target_directory=temporary)
        except (json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError):
            raise InputError(f"{url}: is not PROJ's catalogue of grids; try again later") from None
    facts = next((one["properties"] for one in listed if one["properties"]["name"] == name), None)
    if facts is None or not facts.get("sha256sum"):
        raise InputError(f"{name}: PROJ's catalogue has no grid of this name; skymoor grids list shows some")
    return dict(facts)
