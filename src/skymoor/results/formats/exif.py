# SPDX-License-Identifier: Apache-2.0
"""Position, attitude and lens into copies of photos, as EXIF and XMP; no pixel is touched."""

from __future__ import annotations

import io
import struct

import numpy as np
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from skymoor.errors import InputError
from skymoor.geometry import Intrinsics
from skymoor.results.formats.xmp import PhotoFacts, film_focal_mm, position_xmp
from skymoor.results.tables import CameraRow

EXIF, XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
APP1, SOS, LARGEST = 0xE1, 0xDA, 65533
SENSORS_MM = (2.0, 80.0)  # widths of sensors: some makers state the pixels of another image
SECOND = 10**6  # a millionth of an arc second is 0.03 mm


def photo_with_position(
    jpeg: bytes, row: CameraRow, name: str, lens: Intrinsics | None = None, calibrated: str = "1970-01-01"
) -> bytes:
    """A JPEG file's bytes with GPS tags and XMP instead of its own; all other segments and the pixels stay.

    The altitude is metres above the WGS 84 ellipsoid. With `lens`, calibrated on a date (YYYY-MM-DD), the focal length
    is replaced too. Angles and lens are those of the pixels as they are stored, whatever EXIF's orientation. Raises
    `InputError` when it is no whole JPEG, or its EXIF is larger than a segment holds.
    """
    try:
        with Image.open(io.BytesIO(jpeg)) as image:
            exif = image.getexif()
        facts = photo_facts(exif, image.width)  # also reads that part, which Pillow would else not write again
        if lens is not None:
            _put_lens(exif, lens, facts)
        exif[ExifTags.IFD.GPSInfo] = gps_tags(row)
        segments = [_segment(_exif_bytes(exif)), _segment(XMP + position_xmp(row, lens, facts, calibrated).encode())]
        return jpeg[:2] + b"".join(segments) + _without_metadata(jpeg)
    except (OSError, ValueError, IndexError, struct.error, SyntaxError) as error:
        raise InputError(
            f"{name}: its EXIF cannot be rewritten ({error}); export without exif, or repair the file"
        ) from error


def gps_tags(row: CameraRow) -> dict[int, object]:
    """EXIF's GPS tags of a registered camera, without altitude where its height is not confirmed.

    Altitude reference 0 (or 1, below) is the ellipsoid since EXIF 3.0.
    """
    assert row.lat is not None and row.lon is not None
    tags = ExifTags.GPS
    found: dict[int, object] = {
        tags.GPSVersionID: b"\2\4\0\0",
        tags.GPSLatitudeRef: "N" if row.lat >= 0 else "S",
        tags.GPSLatitude: _sexagesimal(row.lat),
        tags.GPSLongitudeRef: "E" if row.lon >= 0 else "W",
        tags.GPSLongitude: _sexagesimal(row.lon),
        tags.GPSMapDatum: "WGS-84",
    }
    if row.height is not None:
        found[tags.GPSAltitudeRef] = b"\0" if row.height >= 0 else b"\1"
        found[tags.GPSAltitude] = IFDRational(round(abs(row.height) * 10000), 10000)
    if row.ce90 is not None:
        found[tags.GPSHPositioningError] = IFDRational(round(row.ce90 * 1000), 1000)
    return {int(tag): value for tag, value in found.items()}


def photo_facts(exif: Image.Exif, width: int) -> PhotoFacts:
    """The maker and the size of the pixels, where the EXIF of a photo of `width` pixels states them credibly."""
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    unit = {2: 25.4, 3: 10.0, 4: 1.0}.get(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
    density = float(tags.get(ExifTags.Base.FocalPlaneXResolution, 0) or 0)
    known = unit is not None and density > 0 and SENSORS_MM[0] <= width * unit / density <= SENSORS_MM[1]
    return PhotoFacts(str(exif.get(ExifTags.Base.Make, "")).strip("\0 "), density / unit if known and unit else None)


def _put_lens(exif: Image.Exif, lens: Intrinsics, facts: PhotoFacts) -> None:
    """The focal length of the photo: in millimetres only where the size of its pixels is known."""
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    tags[ExifTags.Base.FocalLengthIn35mmFilm] = round(film_focal_mm(lens))
    if facts.px_per_mm is not None:
        tags[ExifTags.Base.FocalLength] = IFDRational(round(np.sqrt(lens.fx * lens.fy) / facts.px_per_mm * 1e6), 10**6)


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    units = round(abs(degrees) * 3600 * SECOND)
    minutes, seconds = divmod(units, 60 * SECOND)
    return IFDRational(minutes // 60, 1), IFDRational(minutes % 60, 1), IFDRational(seconds, SECOND)


def _exif_bytes(exif: Image.Exif) -> bytes:
    found = exif.tobytes()
    return found if found.startswith(EXIF) else EXIF + found


def _segment(content: bytes) -> bytes:
    if len(content) > LARGEST:
        raise ValueError("it is larger than a segment of JPEG holds")
    return struct.pack(">BBH", 0xFF, APP1, len(content) + 2) + content


def _without_metadata(jpeg: bytes) -> bytes:
    """What follows a JPEG's first marker, less its EXIF and XMP."""
    if jpeg[:2] != b"\xff\xd8":
        raise ValueError("no JPEG")
    kept, at = [], 2
    while jpeg[at + 1] != SOS:
        if jpeg[at] != 0xFF:
            raise ValueError("a segment is damaged")
        if jpeg[at + 1] == 0xFF:  # markers may be filled up
            at += 1
            continue
        end = at + 2 + struct.unpack(">H", jpeg[at + 2 : at + 4])[0]
        if not (jpeg[at + 1] == APP1 and jpeg[at + 4 : end].startswith((EXIF, XMP))):
            kept.append(jpeg[at:end])
        at = end
    return b"".join(kept) + jpeg[at:]
