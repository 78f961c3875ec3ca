# SPDX-License-Identifier: Apache-2.0
"""A commented site.toml, drafted after a look at the data: what is there, and what its owner has to state."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skymoor.engines.regular import is_there
from skymoor.errors import BackendUnavailable, InputError
from skymoor.geo import EnuFrame
from skymoor.pipeline.usual_accuracy import USUAL
from skymoor.pipeline.words import size_in_words
from skymoor.reference.raster import MapRaster, opened
from skymoor.sources.addresses import is_address
from skymoor.store import FoundFiles, find_photos, open_image, video_ready

MOST_SIZES = 3
FETCH = "skymoor reference --bbox WEST SOUTH EAST NORTH --ortho SOURCE --dsm SOURCE --out reference"


@dataclass(frozen=True)
class Stated:
    """What a user says of the reference; see `Site`. `ortho` and `dsm` are paths, addresses or, of `dsm`, a height."""

    ortho: str | None = None
    dsm: float | str | None = None
    vertical_datum: str | None = None
    ce90: float | None = None
    le90: float | None = None
    accuracy: str | None = None


@dataclass
class Draft:
    """The text of a site.toml, one line for the screen about each thing that was found, and what is missing in it."""

    lines: list[str] = field(default_factory=list)
    found: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Of the file."""
        return "\n".join(self.lines) + "\n"

    def say(self, what: str, about: str) -> None:
        """The same on the screen and as a comment in the file."""
        self.found.append(f"{what}: {about}")
        self.lines.append(f"# {about}")


def draft_site(file: Path, airborne: Sequence[Path], ground: Sequence[Path], stated: Stated) -> Draft:
    """Look at photos and reference, and draft the site.toml that will lie at `file`; writes nothing.

    Raises `InputError` for photos and rasters that are not there, or cannot be read.
    """
    draft = Draft()
    draft.lines += [
        "# Drafted by skymoor init after a look at the data. Complete what is commented out as TO DO.",
        "# Paths are relative to this file; docs/options.md lists all options.",
        f"name = {_quoted(file.resolve().parent.name or 'site')}",
    ]
    draft.lines += ["", "[reference]"]
    _reference(draft, file, stated)
    rasters = [Path(one) for one in (stated.ortho, stated.dsm) if isinstance(one, str) and not is_address(one)]
    sets = [("[airborne]", tuple(airborne)), *(("[[ground]]", (one,)) for one in ground)]
    for header, sources in sets:
        others = [*rasters, *(one for _, there in sets if there != sources for one in there)]
        draft.lines += ["", header]
        _photos(draft, file, header.strip("[]"), sources, others)
    draft.lines += [
        "",
        "# What you know bounds the search: it is faster then, and a wrong place is less likely.",
        "# [prior]",
        "# near = [47.37, 8.54, 1500]   # latitude, longitude, radius in metres",
        "# height = 80                  # flying height above the ground in metres, right within a quarter",
        '# heading = "240"              # the first photo looks there, or its upper edge points there',
        "",
        "# [options]",
        "# match.max_height_m = 200     # the largest flying height that is searched",
    ]
    return draft


def _reference(draft: Draft, file: Path, stated: Stated) -> None:
    ortho = heights = None
    if stated.ortho is None:
        draft.missing.append("ortho")
        draft.lines += [
            "# TO DO: the orthophoto that covers the site and its surroundings; one is fetched by",
            f"#   {FETCH}",
        ]
        draft.lines.append('# ortho = "reference/ortho.tif"')
    else:
        ortho = _raster(draft, file, "ortho", stated.ortho)
    if stated.dsm is None:
        draft.lines += [
            "# Without a DSM (heights with buildings and trees) places are found, but no heights. Or one height:",
            '# dsm = "reference/dsm.tif"',
            "# dsm = 412.0                  # metres above the vertical datum",
        ]
    elif isinstance(stated.dsm, str):
        heights = _raster(draft, file, "dsm", stated.dsm)
        if ortho is not None and heights is not None:
            _require_overlap(ortho, heights)
    else:
        draft.lines.append(f"dsm = {float(stated.dsm)!r}  # one height of the ground, metres above the vertical datum")
    if stated.dsm is not None:
        _datum(draft, stated, heights)
    _accuracy(draft, stated)


def _raster(draft: Draft, file: Path, key: str, named: str) -> MapRaster | None:
    """Describe a raster, and name it; None for an address, which is not asked."""
    if is_address(named):
        draft.say(key, "an address: the part that is needed is fetched when the site is run")
        draft.lines.append(f"{key} = {_quoted(named)}")
        return None
    path = Path(named)
    raster = MapRaster.of(path)
    lonlat = raster.lonlat_from_px(raster.border_px())
    (west, south), (east, north) = lonlat.min(axis=0), lonlat.max(axis=0)
    frame = EnuFrame(float(south + north) / 2, float(west + east) / 2, 0.0)
    width, height = np.ptp(frame.enu_from_lla(lonlat[:, 1], lonlat[:, 0], 0.0)[:, :2], axis=0)
    rows, columns = raster.shape
    authority = raster.crs.to_authority()
    with opened(path) as source:
        bands, unit = source.count, (source.units[0] or "").strip()
    about = [
        f"{':'.join(authority) if authority else raster.crs.name}, {width:.0f} m by {height:.0f} m",
        f"{columns} by {rows} pixels of {raster.pixel_m(frame):.2g} m",
        f"latitude {south:.5f} to {north:.5f}, longitude {west:.5f} to {east:.5f}",
        f"{bands} band{'s' if bands > 1 else ''}" if key == "ortho" else f"unit of heights: {unit or 'not stated'}",
        size_in_words(path.stat().st_size),
    ]
    draft.say(key, "; ".join(about))
    draft.lines.append(f"{key} = {_quoted(_from(file, path))}")
    return raster


def _require_overlap(ortho: MapRaster, dsm: MapRaster) -> None:
    boxes = [raster.lonlat_from_px(raster.border_px()) for raster in (ortho, dsm)]
    low, high = np.maximum(*(box.min(axis=0) for box in boxes)), np.minimum(*(box.max(axis=0) for box in boxes))
    if (low >= high).any():
        raise InputError(f"orthophoto and DSM do not overlap: {ortho.extent()}; {dsm.extent()}; check both files")


def _datum(draft: Draft, stated: Stated, dsm: MapRaster | None) -> None:
    if stated.vertical_datum is not None:
        draft.lines.append(f"vertical_datum = {_quoted(stated.vertical_datum)}")
    elif dsm is not None and dsm.vertical_datum is not None:
        draft.say("vertical datum", f"the DSM states {dsm.vertical_datum}")
    else:
        draft.missing.append("vertical_datum")
        draft.lines += [
            "# TO DO: the vertical datum of the heights, which the file does not state: see the page of the product.",
            '# vertical_datum = "EPSG:3855"   # EGM2008; EPSG:5773 is EGM96, EPSG:5703 NAVD88; see skymoor grids list',
            '# vertical_datum = "ellipsoid"   # heights above the WGS 84 ellipsoid',
        ]


def _accuracy(draft: Draft, stated: Stated) -> None:
    if stated.accuracy is not None:
        draft.lines.append(f"accuracy = {_quoted(stated.accuracy)}")
        return
    wanted = [("ce90", stated.ce90, "horizontal"), *([] if stated.dsm is None else [("le90", stated.le90, "vertical")])]
    draft.lines += [f"{key} = {value!r}" for key, value, _ in wanted if value is not None]
    lacking = [(key, what) for key, value, what in wanted if value is None]
    if lacking:
        draft.missing += [key for key, _ in lacking]
        draft.lines.append("# TO DO: the accuracy of the reference; nine of ten errors are smaller, in metres.")
        draft.lines += [f"# {key} = 2.0                    # {what}" for key, what in lacking]
        draft.lines.append('# accuracy = "unknown"          # in their place, where nobody knows')
        draft.lines += [f"#   {line}" for line in USUAL]


def _photos(draft: Draft, file: Path, name: str, sources: Sequence[Path], others: Sequence[Path]) -> None:
    for source in sources:
        if not (is_there(source) or is_there(source, folder=True)):
            raise InputError(f"{source}: there is no such folder of images, nor video")
    found = find_photos(sources, file.resolve().parent, others)
    draft.say(name, ", ".join(_about_photos(found)))
    for note in found.notes:
        draft.say(name, note)
    named = [_quoted(_from(file, source)) for source in sources]
    draft.lines.append(f"images = {named[0] if len(named) == 1 else '[' + ', '.join(named) + ']'}")


def _about_photos(found: FoundFiles) -> Iterator[str]:
    if found.photos:
        sizes: Counter[tuple[int, int]] = Counter()
        for photo in found.photos:
            with suppress(Exception), open_image(photo.path) as image:  # a run says what is wrong with it
                sizes[image.size] += 1
        yield f"{len(found.photos)} photos"
        common = [f"{width} by {height} ({count})" for (width, height), count in sizes.most_common(MOST_SIZES)]
        yield " and ".join(common) + (f" and {len(sizes) - MOST_SIZES} more sizes" if len(sizes) > MOST_SIZES else "")
        if sizes.total() < len(found.photos):
            yield f"{len(found.photos) - sizes.total()} cannot be read"
    if found.videos:
        yield f"{len(found.videos)} video{'s' if len(found.videos) > 1 else ''}"
        try:
            video_ready()
        except BackendUnavailable as error:
            yield f"which are left out: {error}"
    yield size_in_words(sum(one.path.stat().st_size for one in (*found.photos, *found.videos)))


def _from(file: Path, path: Path) -> str:
    """A path relative to the folder of a file where it lies in it, else absolute; with forward slashes."""
    folder, whole = file.resolve().parent, Path(os.path.abspath(path))  # noqa: PTH100 - links stay as they are named
    return (whole.relative_to(folder) if whole.is_relative_to(folder) else whole).as_posix()


def _quoted(text: str) -> str:
    """As a string of TOML, which has the escapes of JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
