# SPDX-License-Identifier: Apache-2.0
"""Position, attitude and lens of a photo as XMP, in the tags of Pix4D and DJI."""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

from skymoor.geometry import Intrinsics
from skymoor.results.formats.angles import gimbal_deg, rotation_of, yaw_pitch_roll_deg
from skymoor.results.tables import CameraRow

GIMBAL_MAKES = ("dji", "hasselblad")
FILM_DIAGONAL_MM = float(np.hypot(36, 24))


@dataclass(frozen=True)
class PhotoFacts:
    """What the photo's own EXIF states: the maker, and the number of pixels in a millimetre of its sensor."""

    make: str = ""
    px_per_mm: float | None = None


NOTHING = PhotoFacts()


def position_xmp(
    row: CameraRow, lens: Intrinsics | None = None, facts: PhotoFacts = NOTHING, calibrated: str = "1970-01-01"
) -> str:
    """An XMP packet of a registered camera.

    Position as in EXIF; CE90 and LE90 in metres as Pix4D's `GPSXYAccuracy` and `GPSZAccuracy`; yaw, pitch and roll as
    Pix4D's `Yaw`, `Pitch`, `Roll`, degrees (`angles.yaw_pitch_roll_deg`); of photos by DJI and Hasselblad also
    `GimbalYawDegree` and so on (`angles.gimbal_deg`): in others ODM would take the gimbal's pitch for Pix4D's. The
    lens, where it is given, is in pixels in DJI's `DewarpData` (date `calibrated`; fx, fy, cx, cy from the middle of
    the image, k1, k2, p1, p2, k3), and in millimetres in Pix4D's tags where the photo states the size of its pixels.
    """
    values = _position(row) | _attitude(row, facts)
    if lens is not None:
        values |= _lens(lens, calibrated) | ({} if facts.px_per_mm is None else _lens_mm(lens, facts.px_per_mm))
    inner = "".join(f" {name}={quoteattr(value)}" for name, value in values.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        "<!-- GPSAltitude: metres above the WGS 84 ellipsoid -->"
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:exif="http://ns.adobe.com/exif/1.0/" '
        'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
        f'xmlns:Camera="http://pix4d.com/camera/1.0/"{inner}/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    )


def film_focal_mm(lens: Intrinsics) -> float:
    """The focal length that sees as much, by the diagonal, on 36 x 24 mm film: EXIF's FocalLengthIn35mmFilm."""
    return float(np.sqrt(lens.fx * lens.fy)) * FILM_DIAGONAL_MM / float(np.hypot(lens.width, lens.height))


def _position(row: CameraRow) -> dict[str, str]:
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
    return values


def _attitude(row: CameraRow, facts: PhotoFacts) -> dict[str, str]:
    rotation = rotation_of(row)
    if rotation is None:
        return {}
    angles, gimbal = yaw_pitch_roll_deg(rotation), gimbal_deg(rotation)
    values = dict(zip(("Camera:Yaw", "Camera:Pitch", "Camera:Roll"), (f"{one:.5f}" for one in angles), strict=True))
    if facts.make.strip().lower() in GIMBAL_MAKES and gimbal is not None:
        named = zip(("Yaw", "Pitch", "Roll"), (*gimbal, 0.0), strict=True)
        values |= {f"drone-dji:Gimbal{name}Degree": f"{value:+.5f}" for name, value in named}
    return values


def _lens(lens: Intrinsics, calibrated: str) -> dict[str, str]:
    centre = (lens.cx - lens.width / 2, lens.cy - lens.height / 2)
    numbers = (lens.fx, lens.fy, *centre, *lens.distortion, 0.0)
    return {
        "drone-dji:CalibratedFocalLength": f"{np.sqrt(lens.fx * lens.fy):.6f}",
        "drone-dji:DewarpData": f"{calibrated};" + ",".join(f"{number:.12g}" for number in numbers),
        "drone-dji:DewarpFlag": "0",  # the photo is as the lens saw it
    }


def _lens_mm(lens: Intrinsics, px_per_mm: float) -> dict[str, str]:
    k1, k2, p1, p2 = lens.distortion
    return {
        "Camera:ModelType": "perspective",
        "Camera:PerspectiveFocalLength": f"{np.sqrt(lens.fx * lens.fy) / px_per_mm:.7f}",
        "Camera:PerspectiveFocalLengthUnits": "mm",
        "Camera:PrincipalPoint": f"{lens.cx / px_per_mm:.7f},{lens.cy / px_per_mm:.7f}",
        "Camera:PerspectiveDistortion": ",".join(f"{number:.9g}" for number in (k1, k2, 0.0, p1, p2)),
    }


def _minutes(degrees: float, letters: str) -> str:
    units = round(abs(degrees) * 60 * 10**8)
    whole, rest = divmod(units, 60 * 10**8)
    return f"{whole},{rest // 10**8}.{rest % 10**8:08d}{letters[degrees < 0]}"
