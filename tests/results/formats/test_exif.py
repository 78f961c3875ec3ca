# SPDX-License-Identifier: Apache-2.0
"""Attitude and lens in photos, read by Pillow and an XML parser and turned into a rotation by SciPy."""

from __future__ import annotations

import io
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

from skymoor.geometry import Intrinsics, Similarity
from skymoor.results.formats import photo_with_position
from skymoor.results.formats.angles import gimbal_deg
from skymoor.results.tables import CameraRow
from skymoor.types import Array

LENS = Intrinsics(4000, 3000, 2800.0, 2800.0, 2011.0, 1490.0, (-0.03, 0.01, 1e-3, -2e-3))
CAMERA, DJI = "{http://pix4d.com/camera/1.0/}", "{http://www.dji.com/drone-dji/1.0/}"


def _rotation(yaw: float, tilt: float, roll: float) -> Array:
    """Camera from ENU: turned by `yaw`, `tilt` up from straight down, then `roll` about the line of sight, degrees."""
    north_up = np.diag([1.0, -1.0, -1.0])
    heading = Rotation.from_euler("z", yaw, degrees=True).as_matrix()  # ENU turns the other way
    # A point on the camera's right stays there when it tilts; what is ahead comes to the middle.
    up = Rotation.from_euler("x", -tilt, degrees=True).as_matrix()
    sight = Rotation.from_euler("z", roll, degrees=True).as_matrix()
    return np.asarray(sight @ up @ north_up @ heading)


def _row(rotation: Array) -> CameraRow:
    turn = Similarity(1.0, rotation, np.zeros(3)).quaternion_wxyz.tolist()
    return CameraRow(
        "a.jpg", "airborne", 0, "REGISTERED", 46.0, 7.0, 500.0, **dict(zip(("qw", "qx", "qy", "qz"), turn, strict=True))
    )


def _jpeg(make: str = "DJI", per_cm: float | None = None) -> bytes:
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = make
    if per_cm is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalPlaneXResolution] = per_cm
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalPlaneResolutionUnit] = 3
    out = io.BytesIO()
    Image.new("RGB", (LENS.width, LENS.height)).save(out, "JPEG", exif=exif, quality=1)
    return out.getvalue()


def _tags(jpeg: bytes) -> dict[str, str]:
    with Image.open(io.BytesIO(jpeg)) as image:
        packet = image.info["xmp"]
    return dict(next(ET.fromstring(packet).iter("{http://www.w3.org/1999/02/22-rdf-syntax-ns#}Description")).attrib)


def _by_pix4d(yaw: float, pitch: float, roll: float) -> Array:
    """Camera from ENU by Pix4D's definition: north-east-down, turned about down, right and forward."""
    ned = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    forward, right, down = ned.T
    return np.array([right, -forward, down])[:, [1, 0, 2]] * [1, 1, -1]


def _by_dji(yaw: float, pitch: float, roll: float) -> Array:
    """Camera from ENU by the gimbal's definition: the line of sight is forward, and pitch 0 at the horizon."""
    ned = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    sight, right, down = ned.T
    return np.array([right, down, sight])[:, [1, 0, 2]] * [1, 1, -1]


def _gap_deg(a: Array, b: Array) -> float:
    return float(np.degrees(np.linalg.norm(Rotation.from_matrix(a @ b.T).as_rotvec())))


@pytest.mark.parametrize("yaw", [0.0, 33.0, -120.0, 180.0])
@pytest.mark.parametrize(("tilt", "roll"), [(0, 0), (0.3, 0), (30, 0), (89, 0), (90, 0), (60, 2), (40, 25), (90, -90)])
def test_attitude_comes_back_by_the_definitions_of_pix4d_and_dji(yaw: float, tilt: float, roll: float) -> None:
    rotation = _rotation(yaw, tilt, roll)
    tags = _tags(photo_with_position(_jpeg(), _row(rotation), "a.jpg"))
    angles = [float(tags[f"{CAMERA}{name}"]) for name in ("Yaw", "Pitch", "Roll")]
    assert _gap_deg(_by_pix4d(*angles), rotation) < 1e-4
    if f"{DJI}GimbalPitchDegree" in tags:
        gimbal = [float(tags[f"{DJI}Gimbal{name}Degree"]) for name in ("Yaw", "Pitch", "Roll")]
        assert _gap_deg(_by_dji(*gimbal), rotation) < (1e-4 if roll == 0 else 3.01)
        assert _gap_deg(_by_dji(*gimbal), rotation) > (-1 if roll == 0 else 0.1)  # the roll is dropped, and seen so
    else:
        assert abs(roll) > 20
    if roll == 0:
        assert (angles[0] - yaw + 180) % 360 - 180 == pytest.approx(0, abs=1e-4)  # also at the lock
        assert angles[1] == pytest.approx(tilt, abs=1e-4) and float(tags[f"{DJI}GimbalPitchDegree"]) == pytest.approx(
            tilt - 90, abs=1e-4
        )


def test_straight_down_a_gimbal_has_the_azimuth_of_the_upper_edge_and_no_roll() -> None:
    sideways = Rotation.from_euler("y", 2.0, degrees=True).as_matrix() @ _rotation(70.0, 0.0, 0.0)
    found = gimbal_deg(sideways)
    assert found is not None and found[0] == pytest.approx(70, abs=0.1) and found[1] == pytest.approx(-90, abs=0.1)


def test_photos_of_other_makers_have_no_gimbal() -> None:
    """ODM would take its pitch for Pix4D's, 90 degrees away."""
    tags = _tags(photo_with_position(_jpeg("Acme"), _row(_rotation(10, 20, 0)), "a.jpg", LENS))
    assert f"{CAMERA}Pitch" in tags and not any("Gimbal" in name for name in tags)
    assert not any(name in tags for name in (f"{CAMERA}PerspectiveFocalLength", f"{CAMERA}PrincipalPoint"))


def test_the_lens_comes_back_in_pixels_and_where_they_have_a_size_in_millimetres() -> None:
    copy = photo_with_position(_jpeg(per_cm=4000 / 1.32), _row(_rotation(0, 0, 0)), "a.jpg", LENS, "2026-05-04")
    tags = _tags(copy)
    date, _, numbers = tags[f"{DJI}DewarpData"].partition(";")
    fx, fy, cx, cy, *brown = map(float, numbers.split(","))
    assert date == "2026-05-04" and tags[f"{DJI}DewarpFlag"] == "0"
    xyz = np.random.default_rng(2).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (50, 3))
    # The middle of the image is at (n - 1) / 2 for OpenCV, whose first pixel's centre is (0, 0).
    lens = np.array([[fx, 0, cx + 3999 / 2], [0, fy, cy + 2999 / 2], [0, 0, 1]])
    px, _ = cv2.projectPoints(xyz, np.zeros(3), np.zeros(3), lens, np.array(brown))
    np.testing.assert_allclose(px[:, 0] + 0.5, LENS.px_from_cam(xyz), atol=1e-3)
    mm = 13.2 / 4000
    assert float(tags[f"{CAMERA}PerspectiveFocalLength"]) == pytest.approx(2800 * mm, rel=1e-6)
    np.testing.assert_allclose(
        [float(one) for one in tags[f"{CAMERA}PrincipalPoint"].split(",")], [2011 * mm, 1490 * mm], rtol=1e-6
    )
    exif = Image.open(io.BytesIO(copy)).getexif().get_ifd(ExifTags.IFD.Exif)
    assert float(exif[ExifTags.Base.FocalLength]) == pytest.approx(9.24, rel=1e-5)
    assert exif[ExifTags.Base.FocalLengthIn35mmFilm] == 24  # 2800 of a diagonal of 5000: 24.2 of 43.3 mm


def test_a_focal_length_in_millimetres_is_not_invented() -> None:
    copy = photo_with_position(_jpeg(), _row(_rotation(0, 0, 0)), "a.jpg", LENS)
    exif = Image.open(io.BytesIO(copy)).getexif().get_ifd(ExifTags.IFD.Exif)
    assert ExifTags.Base.FocalLength not in exif and exif[ExifTags.Base.FocalLengthIn35mmFilm] == 24
