# SPDX-License-Identifier: Apache-2.0
"""Cameras for RealityScan (RealityCapture): flight log in WGS 84, table and XMP sidecars in metres of the site."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skymoor.geometry import Intrinsics
from skymoor.results.formats.angles import angle_cells, yaw_pitch_roll_deg
from skymoor.results.tables import CameraRow
from skymoor.types import Array, Camera

FILM_WIDTH_MM = 36.0
CAMERAS = "#name,x,y,alt,heading,pitch,roll"
FLIGHT_LOG = "#name,longitude,latitude,altitude,yaw,pitch,roll,accuracy_x,accuracy_y,accuracy_z"


def realityscan_flight_log(rows: Sequence[CameraRow], names: Mapping[str, str]) -> str:
    """A flight log in EPSG:4326: degrees, ellipsoidal metres, angles, and CE90, CE90 and LE90 in metres.

    Cells stay empty where heights are not confirmed or something is not known.
    """
    lines = [FLIGHT_LOG]
    for row in rows:
        height, ce90, le90 = ("" if one is None else f"{one:.4f}" for one in (row.height, row.ce90, row.le90))
        place = [f"{row.lon:.10f}", f"{row.lat:.10f}", height]
        lines.append(",".join([names[row.image], *place, *angle_cells(row), ce90, ce90, le90]))
    return "\n".join(lines) + "\n"


def realityscan_cameras(cameras_enu: Sequence[Camera], names: Mapping[str, str]) -> str:
    """A table of the cameras in local coordinates: metres east, north, up, and heading, pitch, roll in degrees."""
    lines = [CAMERAS]
    for camera in cameras_enu:
        numbers = [f"{one:.6f}" for one in camera.centre]
        numbers += [f"{one:.7f}" for one in yaw_pitch_roll_deg(camera.cam_from_world.rotation)]
        lines.append(",".join([names[camera.image], *numbers]))
    return "\n".join(lines) + "\n"


def realityscan_xmp(camera: Camera, group: int) -> str:
    """A sidecar with pose and lens in the namespace xcr; `group` is the same for photos of one lens.

    The rotation is camera-from-world, row by row, and the position the centre in metres east, north, up. Lengths on the
    image count in its longer side: the focal length as on film 36 mm wide, the principal point from the middle. The
    distortion is Brown's k1, k2, k3, k4 and two tangential terms, in the other order than OpenCV's ("RealityCapture XMP
    Camera Math"; checked against the importer of AliceVision).
    """
    i = camera.intrinsics
    side = max(i.width, i.height)
    k1, k2, p1, p2 = i.distortion
    values = {
        "Version": "3",
        "PosePrior": "exact",
        "Coordinates": "absolute",
        "DistortionModel": "brown3t2" if any((p1, p2)) else "brown3",
        "FocalLength35mm": repr(i.fx / side * FILM_WIDTH_MM),
        "Skew": "0",
        "AspectRatio": repr(i.fy / i.fx),
        "PrincipalPointU": repr((i.cx - i.width / 2) / side),
        "PrincipalPointV": repr((i.cy - i.height / 2) / side),
        "CalibrationPrior": "exact",
        "CalibrationGroup": str(group),
        "DistortionGroup": str(group),
        "InTexturing": "1",
        "InMeshing": "1",
    }
    parts = {
        "Rotation": camera.cam_from_world.rotation.ravel(),
        "Position": camera.centre,
        "DistortionCoeficients": np.array([k1, k2, 0.0, 0.0, p2, p1]),  # as the format spells it
    }
    return _sidecar(values, parts)


def _sidecar(values: Mapping[str, str], parts: Mapping[str, Array]) -> str:
    inner = "".join(f' xcr:{name}="{value}"' for name, value in values.items())
    text = "".join(
        f"<xcr:{name}>{' '.join(repr(float(one)) for one in numbers)}</xcr:{name}>" for name, numbers in parts.items()
    )
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#"{inner}>{text}'
        "</rdf:Description></rdf:RDF></x:xmpmeta>\n"
    )


def lens_groups(cameras: Sequence[Camera]) -> dict[Intrinsics, int]:
    """A number for each lens, from 1 on; -1 would mean that a photo is calibrated on its own."""
    return {lens: k + 1 for k, lens in enumerate(dict.fromkeys(camera.intrinsics for camera in cameras))}
