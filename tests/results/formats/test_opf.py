# SPDX-License-Identifier: Apache-2.0
"""An OPF project, read by Pix4D's own library and projected by its definition."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pyproj import CRS, Transformer
from scipy.spatial.transform import Rotation

from skymoor.results.export import export
from skymoor.results.read import Result
from support.exported_run import FRAME, LENS, cameras, points, write_run

io = pytest.importorskip("pyopf.io")
resolve = pytest.importorskip("pyopf.resolve")


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    root = tmp_path_factory.mktemp("opf")
    export(Result.read(write_run(root)), ["opf"], root / "out", lambda _: None)
    folder = root / "out" / "opf"
    return folder, resolve.resolve(io.load(str(folder / "project.opf")))


def test_pix4d_s_library_opens_every_item(opened: tuple[Path, Any]) -> None:
    folder, project = opened
    assert len(project.camera_list.cameras) == len(project.input_cameras.captures) == 4
    assert len(project.calibration.calibrated_cameras.cameras) == 4
    for camera in json.loads((folder / "camera_list.json").read_text())["cameras"]:
        assert (folder / camera["uri"]).is_file()
    (sensor,) = project.input_cameras.sensors
    assert list(sensor.image_size_px) == [LENS.width, LENS.height]


def test_inputs_are_wgs84_latitude_first_with_standard_deviations(opened: tuple[Path, Any]) -> None:
    for capture, camera in zip(opened[1].input_cameras.captures, cameras()[:4], strict=True):
        lat, lon, height = capture.geolocation.coordinates
        np.testing.assert_allclose(FRAME.enu_from_lla(lat, lon, height)[0], camera.centre, atol=1e-4)
        np.testing.assert_allclose(capture.geolocation.sigmas, [2.1 / 2.146, 2.1 / 2.146, 3.8 / 1.645], rtol=1e-3)


def test_calibrated_cameras_project_points_by_the_definition(opened: tuple[Path, Any]) -> None:
    project = opened[1]
    scene = project.scene_reference_frame
    crs = CRS.from_wkt(scene.crs.definition)
    assert len(crs.axis_info) == 3
    lat, lon, height = FRAME.lla_from_enu(points()).T
    base = np.column_stack(Transformer.from_crs("EPSG:4979", crs, always_xy=True).transform(lon, lat, height))
    world = base * scene.base_to_canonical.scale + scene.base_to_canonical.shift
    internals = project.calibration.calibrated_cameras.sensors[0].internals
    f, (cx, cy) = internals.focal_length_px, internals.principal_point_px
    brown = np.array([*internals.radial_distortion[:2], *internals.tangential_distortion])
    for found, camera in zip(project.calibration.calibrated_cameras.cameras, cameras()[:4], strict=True):
        turn = Rotation.from_euler("XYZ", found.orientation_deg, degrees=True).as_matrix()
        image = (world - found.position) @ turn * [1, -1, -1]  # right, top, back to right, down, ahead
        lens = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
        px, _ = cv2.projectPoints(image, np.zeros(3), np.zeros(3), lens, brown)
        want = camera.intrinsics.px_from_cam(camera.cam_from_world.apply(points()))
        # The two focal lengths differ by 0.8 %, which one number cannot say: compare without that.
        scale = [LENS.fx / f, LENS.fy / f]
        np.testing.assert_allclose((px[:, 0] - [cx, cy]) * scale, want - [cx, cy], atol=1e-3)
        np.testing.assert_allclose(found.position, camera.centre, atol=0.01)
