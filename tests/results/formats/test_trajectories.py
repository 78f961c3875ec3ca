# SPDX-License-Identifier: Apache-2.0
"""Poses for TUM, Metashape and RealityScan: by their definitions, and by the readers of given models."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

from skymoor.models.metashape import cameras_of_metashape
from skymoor.models.realityscan import rotation_of, table_of
from skymoor.results.export import export
from skymoor.results.read import Result
from skymoor.types import Array
from support.exported_run import FRAME, LENS, cameras, points, write_run

NAMES = ["p0.jpg", "p1.jpg", "p2.jpg", "p3.png"]
XCR = "{http://www.capturingreality.com/ns/xcr/1.1#}"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("trajectories")
    export(Result.read(write_run(root)), ["tum,metashape,realityscan"], root / "out", lambda _: None)
    return root / "out"


def _camera_from_enu(yaw: float, pitch: float, roll: float) -> Array:
    """North-east-down axes turned into those of an aircraft that looks down: forward is up in the image."""
    forward, right, down = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix().T
    return np.array([right, -forward, down])[:, [1, 0, 2]] * [1, 1, -1]


def test_tum_is_world_from_camera(out: Path) -> None:
    rows = np.loadtxt(out / "tum" / "airborne_0.txt")
    assert rows.shape == (4, 8)
    np.testing.assert_array_equal(rows[:, 0], range(4))  # the photos have no times
    np.testing.assert_allclose(rows[:, 1:4], [camera.centre for camera in cameras()[:4]], atol=1e-6)
    turns = Rotation.from_quat(rows[:, 4:]).as_matrix()  # x, y, z, w
    for turn, camera in zip(turns, cameras(), strict=False):
        np.testing.assert_allclose(turn @ camera.cam_from_world.rotation, np.eye(3), atol=1e-8)
    images = (out / "tum" / "airborne_0_images.txt").read_text().splitlines()[1:]
    assert [line.split()[1] for line in images] == [camera.image for camera in cameras()[:4]]


def test_tum_has_the_times_of_the_photos_where_all_have_one(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    for k, camera in enumerate(cameras()[:4]):
        exif = Image.Exif()
        tags = exif.get_ifd(ExifTags.IFD.Exif)
        tags[ExifTags.Base.DateTimeOriginal] = f"2026:05:04 10:00:0{9 - k}"
        tags[ExifTags.Base.SubsecTimeOriginal] = "25"
        Image.new("RGB", (LENS.width, LENS.height)).save(tmp_path / camera.image, "JPEG", exif=exif)
    export(Result.read(run), ["tum"], tmp_path / "out", lambda _: None)
    rows = np.loadtxt(tmp_path / "out/tum/airborne_0.txt")
    np.testing.assert_allclose(np.diff(rows[:, 0]), 1)
    assert rows[0, 0] % 60 == pytest.approx(6.25)
    np.testing.assert_allclose(rows[0, 1:4], cameras()[3].centre, atol=1e-6)


def test_metashape_reference_has_position_accuracy_and_angles(out: Path) -> None:
    head, *lines = (out / "metashape" / "airborne_0.csv").read_text().splitlines()
    assert head.split(",")[:4] == ["#Label", "Longitude", "Latitude", "Altitude"]
    for line, camera, name in zip(lines, cameras()[:4], NAMES, strict=True):
        label, *numbers = line.split(",")
        lon, lat, height, ce90, le90, yaw, pitch, roll = map(float, numbers)
        assert (label, ce90, le90) == (name, 2.1, 3.8)
        np.testing.assert_allclose(FRAME.enu_from_lla(lat, lon, height)[0], camera.centre, atol=1e-3)
        np.testing.assert_allclose(_camera_from_enu(yaw, pitch, roll), camera.cam_from_world.rotation, atol=1e-6)


def test_metashape_cameras_project_by_its_own_formula(out: Path) -> None:
    """x = X / Z, then k, then p1 with r^2 + 2 x^2 in x; u = w / 2 + cx + x f + x b1 (its manual)."""
    chunk = ET.parse(out / "metashape" / "airborne_0.xml").find("chunk")
    assert chunk is not None
    calibration = chunk.find("sensors/sensor/calibration")
    assert calibration is not None
    names = ("f", "cx", "cy", "b1", "k1", "k2", "p1", "p2")
    f, cx, cy, b1, k1, k2, p1, p2 = (float(calibration.findtext(name) or "nan") for name in names)
    for node, camera in zip(chunk.iterfind("cameras/camera"), cameras()[:4], strict=True):
        pose = np.array((node.findtext("transform") or "").split(), float).reshape(4, 4)
        x, y, z = (np.linalg.inv(pose) @ np.column_stack([points(), np.ones(60)]).T)[:3]
        x, y = x / z, y / z
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2
        dx = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
        dy = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
        px = np.column_stack([LENS.width / 2 + cx + dx * (f + b1), LENS.height / 2 + cy + dy * f])
        want = camera.intrinsics.px_from_cam(camera.cam_from_world.apply(points()))
        np.testing.assert_allclose(px, want, atol=1e-6)


def test_metashape_cameras_come_back_by_the_reader_of_given_models(out: Path) -> None:
    for posed, camera, name in zip(
        cameras_of_metashape(out / "metashape" / "airborne_0.xml"), cameras()[:4], NAMES, strict=True
    ):
        assert posed.image == name
        np.testing.assert_allclose(posed.rotation, camera.cam_from_world.rotation, atol=1e-12)
        np.testing.assert_allclose(posed.translation, camera.cam_from_world.translation, atol=1e-9)
        np.testing.assert_allclose(posed.params, [LENS.fx, LENS.fy, LENS.cx, LENS.cy, *LENS.distortion])


def test_realityscan_sidecars_project_by_its_own_formula(out: Path) -> None:
    for camera, name in zip(cameras()[:4], NAMES, strict=True):
        file = out / "realityscan" / "airborne_0" / "xmp" / f"{name.partition('.')[0]}.xmp"
        node = next(ET.parse(file).iter("{http://www.w3.org/1999/02/22-rdf-syntax-ns#}Description"))
        rotation, position, brown = (
            np.array((node.findtext(f"{XCR}{part}") or "").split(), float)
            for part in ("Rotation", "Position", "DistortionCoeficients")
        )
        f, aspect, u, v = (
            float(node.attrib[f"{XCR}{part}"])
            for part in ("FocalLength35mm", "AspectRatio", "PrincipalPointU", "PrincipalPointV")
        )
        side, turn = max(LENS.width, LENS.height), rotation.reshape(3, 3)
        f *= side / 36
        lens = np.array([[f, 0, LENS.width / 2 + u * side], [0, f * aspect, LENS.height / 2 + v * side], [0, 0, 1]])
        opencv = np.array([brown[0], brown[1], brown[5], brown[4], brown[2]])
        px, _ = cv2.projectPoints(points(), cv2.Rodrigues(turn)[0], -turn @ position, lens, opencv)
        want = camera.intrinsics.px_from_cam(camera.cam_from_world.apply(points()))
        np.testing.assert_allclose(px[:, 0], want, atol=1e-3)
        assert node.attrib[f"{XCR}DistortionModel"] == "brown3t2"


def test_realityscan_tables_come_back_by_the_reader_of_given_models(out: Path) -> None:
    _, rows = table_of(out / "realityscan" / "airborne_0" / "cameras.csv")
    for row, camera in zip(rows, cameras()[:4], strict=True):
        np.testing.assert_allclose([float(row[name]) for name in ("x", "y", "alt")], camera.centre, atol=1e-5)
        turn = rotation_of(row)
        assert turn is not None
        np.testing.assert_allclose((turn * [1, -1, -1]).T, camera.cam_from_world.rotation, atol=1e-7)


def test_realityscan_flight_log_is_in_wgs84(out: Path) -> None:
    _, *lines = (out / "realityscan" / "airborne_0" / "flight_log.csv").read_text().splitlines()
    for line, camera, name in zip(lines, cameras()[:4], NAMES, strict=True):
        found, *numbers = line.split(",")
        lon, lat, height, yaw, pitch, roll, *accuracy = map(float, numbers)
        assert (found, accuracy) == (name, [2.1, 2.1, 3.8])
        np.testing.assert_allclose(FRAME.enu_from_lla(lat, lon, height)[0], camera.centre, atol=1e-3)
        np.testing.assert_allclose(_camera_from_enu(yaw, pitch, roll), camera.cam_from_world.rotation, atol=1e-6)
