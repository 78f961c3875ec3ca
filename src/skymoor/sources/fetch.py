# SPDX-License-Identifier: Apache-2.0
"""Fetch a reference: orthophoto and DSM of a bounding box as files, with what is known of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skymoor.errors import InputError
from skymoor.sources.copying import Copied, copy_part
from skymoor.sources.fragment import TABLE, reference_table
from skymoor.sources.known import Facts, Kind, joined
from skymoor.sources.layers import Layer, layer_of
from skymoor.sources.remote import tile_folder
from skymoor.sources.stac import BBox, Wanted
from skymoor.store import atomic_files
from skymoor.types import Progress, no_progress

ORTHO, DSM = "ortho.tif", "dsm.tif"
KINDS: dict[str, Kind] = {ORTHO: "ortho", DSM: "dsm"}
Fetched = tuple[Layer, Copied]
"""A source and what was copied of it."""


@dataclass(frozen=True)
class FetchedReference:
    """What is there now: files, what is known of them, the table [reference] as a file, and sentences for the user.

    `facts` hold datum and accuracy of both together: the larger error counts. `dsm` is None where none was asked for.
    """

    ortho: Path
    dsm: Path | None
    facts: Facts
    table: Path
    notes: tuple[str, ...]


def fetch_reference(
    ortho: str,
    dsm: str | None,
    out: Path,
    *,
    bbox: BBox | None = None,
    pixel_m: float | None = None,
    date: str | None = None,
    track: Callable[[str], Progress] = lambda name: no_progress,
) -> FetchedReference:
    """Copy the part of an orthophoto and of its DSM that lies in a bounding box into a folder, all or nothing.

    Sources are files, addresses of rasters (https://, s3://), STAC items, collections and searches, tile services with
    {x}, {y} and {z}, or WMTS:ADDRESS (docs/references.md). `reference.toml` is written beside them: the table
    [reference] of a site.toml.

    Args:
        ortho: source of the orthophoto.
        dsm: source of the DSM; None where no heights are wanted.
        out: the folder; files of an earlier call are replaced, others are an error.
        bbox: west, south, east, north in WGS 84 degrees; everything where None. The DSM is cut as the orthophoto is.
        pixel_m: an overview whose pixel is not larger is copied, and decides the level of a tile service.
        date: of STAC items, such as "2022" or "2021-04-01/2022-10-31"; the newest counts.
        track: gives the progress callback of each file, by its name.

    Raises:
        InputError: a source cannot be read, is not clear, does not cover the box, or is too large; one line names the
            address, without keys, and the remedy.
    """
    box = None if bbox is None else _checked(bbox)
    _require_own_folder(out)
    sources = {name: source for name, source in ((ORTHO, ortho), (DSM, dsm)) if source is not None}
    fetched: dict[str, Fetched] = {}
    atomic_files(
        out,
        [*sources, TABLE],
        lambda folder: fetched.update(_filled(folder, sources, Wanted(box, date), pixel_m, track)),
    )
    if dsm is None:
        (out / DSM).unlink(missing_ok=True)  # of an earlier call
    notes = tuple(_note(out / name, *found) for name, found in fetched.items())
    return FetchedReference(out / ORTHO, out / DSM if DSM in fetched else None, _facts(fetched), out / TABLE, notes)


def _filled(
    folder: Path,
    sources: Mapping[str, str],
    wanted: Wanted,
    pixel_m: float | None,
    track: Callable[[str], Progress],
) -> dict[str, Fetched]:
    """Write all files into a folder; the DSM is cut as the orthophoto is."""
    fetched: dict[str, Fetched] = {}
    with tile_folder(folder / "tiles"):
        for name, source in sources.items():
            # A coarse pixel is asked of images; heights are coarser anyway.
            layer = layer_of(source, KINDS[name], wanted, pixel_m if name == ORTHO else None)
            copied = copy_part(layer, folder / name, wanted.bbox, _tags(layer), track(name))
            if name == DSM and copied.is_image:
                raise InputError(
                    f"{layer.shown}: is an image and holds no heights; give a raster of heights as the DSM"
                )
            fetched[name] = layer, copied
            wanted = replace(wanted, bbox=wanted.bbox or copied.bbox)
    (folder / TABLE).write_text(reference_table(_facts(fetched), fetched, wanted.bbox), encoding="utf-8")
    return fetched


def _checked(bbox: BBox) -> BBox:
    west, south, east, north = (float(value) for value in bbox)
    if not np.isfinite([west, south, east, north]).all() or not (
        -180 <= west < east <= 180 and -90 <= south < north <= 90
    ):
        raise InputError(
            f"--bbox {west:g} {south:g} {east:g} {north:g}: give west, south, east and north in degrees, west below "
            "east and south below north; a box across the antimeridian is not possible"
        )
    return west, south, east, north


def _require_own_folder(out: Path) -> None:
    if (out / TABLE).exists():
        return
    for name in (ORTHO, DSM):
        if (out / name).exists():
            raise InputError(
                f"{out / name}: is not of this command, and would be replaced; give another folder with --out"
            )


def _facts(fetched: Mapping[str, Fetched]) -> Facts:
    """Of both: licences and credits of all, the datum of the heights, and the larger error where both are known."""
    of = {name: layer.facts for name, (layer, _) in fetched.items()}
    both, errors = joined(of.values()), [facts.ce90 for facts in of.values()]
    both = replace(both, ce90=None if None in errors else max(error for error in errors if error is not None))
    if DSM not in fetched:
        return replace(both, vertical_datum=None, le90=None)
    datum = fetched[DSM][1].vertical_datum or of[DSM].vertical_datum
    return replace(both, vertical_datum=datum, le90=of[DSM].le90, date=of[ORTHO].date or both.date)


def _tags(layer: Layer) -> dict[str, str]:
    tags = {"TIFFTAG_IMAGEDESCRIPTION": f"part of {layer.shown}", "TIFFTAG_SOFTWARE": "skymoor"}
    rights = "; ".join(text for text in (layer.facts.licence, layer.facts.credit) if text)
    return tags | ({"TIFFTAG_COPYRIGHT": rights} if rights else {})


def _note(path: Path, layer: Layer, copied: Copied) -> str:
    size = max(path.stat().st_size / 1e6, 0.01)
    several = f", {len(layer.names)} rasters" if len(layer.names) > 1 else ""
    empty = "" if copied.known_share > 0.995 else f", {100 * (1 - copied.known_share):.0f} % of it without data"
    return (
        f"{path}: {copied.width} by {copied.height} pixels of {copied.pixel_m:.2g} m, {size:.2g} MB, "
        f"from {layer.shown}{several}{empty}"
    )
