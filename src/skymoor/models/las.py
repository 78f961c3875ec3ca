# SPDX-License-Identifier: Apache-2.0
"""Point clouds as LAS, LAZ or COPC, and as E57."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.models.checks import checked_points, geocentric_up, readable
from skymoor.models.given import Z_UP, Cloud, GivenModel, Part
from skymoor.types import Array, Image

HEADER_BYTES = 375
RECORDS = ((100, 54), (243, 60))
"""Where the header has the numbers of records of variable length, since LAS 1.4 also behind the points, and how many
bytes one has at least."""
COMPRESSED = 0x80  # in the number of the point format, of LAZ; its table of chunks lies where the points begin to say
MOST_POINTS = 8_000_000
"""Points that are rendered, evenly thinned out; all of them are moved."""


def read_las(path: Path) -> GivenModel:
    """A LAS, LAZ or COPC cloud. Raises `InputError` where it cannot be used."""
    with readable(path, "LAS or LAZ file"):
        _require_short_header(path)
        cloud = laspy.read(path)
    step = max(1, -(-len(cloud.points) // MOST_POINTS))
    points = checked_points(np.asarray(cloud.xyz)[::step], path)
    colours = None
    if {"red", "green", "blue"} <= set(cloud.point_format.dimension_names):
        colours = _eight_bit(np.column_stack([np.asarray(cloud[name])[::step] for name in ("red", "green", "blue")]))
    try:
        crs = cloud.header.parse_crs()
    except Exception:  # of text that PROJ does not know
        crs = None
    if crs is not None and crs.is_geographic and not crs.is_geocentric:
        raise InputError(f"{path}: its coordinates are degrees; convert it to a map projection, such as UTM")
    up = geocentric_up(points)
    return GivenModel(
        path.stem, (Part("las", path),), Cloud(points, colours), up=Z_UP if up is None else up, unit_m=_unit_m(crs)
    )


def _require_short_header(path: Path) -> None:
    """Readers go on for hours, or end the process, where a file claims billions of records. Raises `ValueError`."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES).ljust(HEADER_BYTES, b"\0")
        claims = [(struct.unpack_from("<I", head, at)[0], least) for at, least in RECORDS if at < 200 or head[25] >= 4]
        if head[104] & COMPRESSED:
            file.seek(min(struct.unpack_from("<I", head, 96)[0], size))
            at = struct.unpack("<q", file.read(8).ljust(8, b"\0"))[0]
            file.seek(at if 0 <= at < size else size)
            claims.append((struct.unpack("<II", file.read(8).ljust(8, b"\0"))[1], 1))
    for claimed, least in claims:
        if claimed * least > size:
            raise ValueError(f"it claims {claimed} records in its header, and is too short for them")


def read_e57(path: Path) -> GivenModel:
    """All scans of an E57 file, each where its pose puts it. Raises `InputError` where it cannot be used."""
    pye57 = require("pye57", "models")
    with readable(path, "E57 file"):
        file = pye57.E57(str(path))
        scans = [_scan(file, k) for k in range(file.scan_count)]
    points = checked_points(np.concatenate([np.zeros((0, 3)), *(xyz for xyz, _ in scans)]), path)
    known = [colours for _, colours in scans if colours is not None]
    colours = _eight_bit(np.concatenate(known)) if len(known) == len(scans) else None
    up = geocentric_up(points)
    # The standard has metres and leaves up open; scanners are levelled.
    return GivenModel(
        path.stem, (Part("e57", path),), Cloud(points, colours), up=Z_UP if up is None else up, unit_m=1.0
    )


def _scan(file: object, index: int) -> tuple[Array, Image | None]:
    fields = set(file.get_header(index).point_fields)  # type: ignore[attr-defined]
    coloured = {"colorRed", "colorGreen", "colorBlue"} <= fields
    data = file.read_scan(index, colors=coloured, ignore_missing_fields=True)  # type: ignore[attr-defined]
    xyz = np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"])
    return xyz, np.column_stack([data[f"color{name}"] for name in ("Red", "Green", "Blue")]) if coloured else None


def _unit_m(crs: CRS | None) -> float | None:
    """Metres of the unit of a CRS's first axis."""
    return None if crs is None else float(crs.axis_info[0].unit_conversion_factor)


def _eight_bit(colours: Array | Image) -> Image | None:
    """Colours of 8 or 16 bits as 8; None where they are all black, as where a field was left empty."""
    if not colours.any():
        return None
    return (np.asarray(colours) // 257 if colours.max() > 255 else np.asarray(colours)).astype(np.uint8)
