# SPDX-License-Identifier: Apache-2.0
"""Positions into copies of photos, as EXIF and XMP; no pixel is touched."""

from __future__ import annotations

import io
import struct
from xml.sax.saxutils import quoteattr

from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from skymoor.errors import InputError
from skymoor.results.tables import CameraRow

EXIF, XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
APP1, SOS, LARGEST = 0xE1, 0xDA, 65533
SECOND = 10**6  # a millionth of an arc second is 0.03 mm


def photo_with_position(jpeg: bytes, row: CameraRow, name: str) -> bytes:
    """A JPEG file's bytes with GPS tags and XMP instead of its own; all other segments and the pixels stay.

    The altitude is metres above the WGS 84 ellipsoid. Raises `InputError` when it is no whole JPEG, or its EXIF is
    larger than a segment holds.
    """
    try:
        with Image.open(io.BytesIO(jpeg)) as image:
            exif = image.getexif()
        exif.get_ifd(ExifTags.IFD.Exif)  # or Pillow would not write that part again
        exif[ExifTags.IFD.GPSInfo] = gps_tags(row)
        segments = [_segment(_exif_bytes(exif)), _segment(XMP + position_xmp(row).encode())]
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


def position_xmp(row: CameraRow) -> str:
    """An XMP packet with the same position and, as photogrammetry reads it, CE90 and LE90 in metres."""
    assert row.lat is not None and row.lon is not None
    values = {
        "exif:GPSLatitude": _minutes(row.lat, "NS"),
        "exif:GPSLongitude": _minutes(row.lon, "EW"),
        "exif:GPSMapDatum": "WGS-84",
    }
    if row.height is not None:
        values["exif:GPSAltitude"] = f"{round(abs(row.height) * 10000)}/10000"
        values["exif:GPSAltitudeRef"] = "0" if row.height >= 0 else "1"
    for name, value in (("Camera:GPSXYAccuracy", row.ce90), ("Camera:GPSZAccuracy", row.le90)):
        if value is not None:
            values[name] = f"{value:.3f}"
    inner = "".join(f" {name}={quoteattr(value)}" for name, value in values.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        "<!-- GPSAltitude: metres above the WGS 84 ellipsoid -->"
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:exif="http://ns.adobe.com/exif/1.0/" '
        f'xmlns:Camera="http://pix4d.com/camera/1.0/"{inner}/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    )


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    units = round(abs(degrees) * 3600 * SECOND)
    minutes, seconds = divmod(units, 60 * SECOND)
    return IFDRational(minutes // 60, 1), IFDRational(minutes % 60, 1), IFDRational(seconds, SECOND)


def _minutes(degrees: float, letters: str) -> str:
    units = round(abs(degrees) * 60 * 10**8)
    whole, rest = divmod(units, 60 * 10**8)
    return f"{whole},{rest // 10**8}.{rest % 10**8:08d}{letters[degrees < 0]}"


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
