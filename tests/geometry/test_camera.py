# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Intrinsics

Array = NDArray[np.float64]
CAMERAS = {
    "pinhole": Intrinsics(1000, 800, 900.0, 905.0, 510.0, 390.0),
    "barrel": Intrinsics(1000, 800, 900.0, 905.0, 510.0, 390.0, (-0.28, 0.09, 1e-3, -2e-3)),
    "folding": Intrinsics(1000, 800, 900.0, 905.0, 510.0, 390.0, (-0.25, 0.0, 5e-4, 1e-3)),
    "pincushion": Intrinsics(4000, 3000, 2800.0, 2800.0, 2003.0, 1498.0, (0.12, 0.02, 0.0, 0.0)),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def pixels(camera: Intrinsics, n: int = 300) -> Array:
    return np.random.default_rng(0).uniform(0, 1, (n, 2)) * [camera.width, camera.height]


@cameras
def test_pixel_to_ray_and_back(camera: Intrinsics) -> None:
    px = pixels(camera)
    rays = camera.rays(px)
    np.testing.assert_array_equal(rays[:, 2], 1.0)
    np.testing.assert_allclose(camera.px_from_cam(rays * 7.0), px, atol=1e-9)


@cameras
def test_agrees_with_colmap(camera: Intrinsics) -> None:
    colmap = pycolmap.Camera(
        model="OPENCV",
        width=camera.width,
        height=camera.height,
        params=[camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion],
    )
    px = pixels(camera)
    xyz_cam = camera.rays(px) * 3.0
    np.testing.assert_allclose(camera.px_from_cam(xyz_cam), colmap.img_from_cam(xyz_cam), atol=1e-9)
    np.testing.assert_allclose(camera.rays(px)[:, :2], colmap.cam_from_img(px), atol=1e-8)


@cameras
def test_agrees_with_opencv_half_a_pixel_apart(camera: Intrinsics) -> None:
    xyz_cam = camera.rays(pixels(camera)) * 3.0
    px_cv, _ = cv2.projectPoints(xyz_cam, np.zeros(3), np.zeros(3), camera.matrix_cv(), np.array(camera.distortion))
    np.testing.assert_allclose(camera.px_from_cam(xyz_cam), px_cv[:, 0] + 0.5, atol=1e-9)


def test_matrix_projects() -> None:
    camera = CAMERAS["pinhole"]
    homogeneous = np.array([0.1, -0.2, 1.0]) @ camera.matrix().T
    np.testing.assert_allclose(camera.px_from_cam([[0.1, -0.2, 1.0]])[0], homogeneous[:2])


def test_points_behind_the_camera_are_nan() -> None:
    px = CAMERAS["barrel"].px_from_cam([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0.1, 0.1, 1.0]])
    assert np.isnan(px).all(axis=1).tolist() == [True, True, False]


def test_polynomial_does_not_fold_back() -> None:
    camera = CAMERAS["folding"]
    assert camera.max_radius == pytest.approx(np.sqrt(1 / 0.75))
    # Without the guard x = 2 would come out at the image's centre, as 2 - 0.25 * 8 = 0.
    px = camera.px_from_cam([[2.0, 0.0, 1.0], [1.2, 0.0, 1.0], [1.1, 0.0, 1.0]])
    assert np.isnan(px).all(axis=1).tolist() == [True, True, False]
    assert CAMERAS["pincushion"].max_radius == CAMERAS["pinhole"].max_radius == np.inf


def test_resized_scales_pixels() -> None:
    camera = CAMERAS["barrel"]
    px = pixels(camera)
    half = camera.resized(500, 200)
    np.testing.assert_allclose(half.px_from_cam(camera.rays(px)), px * [0.5, 0.25], atol=1e-9)


def test_undistorted_keeps_focal_length() -> None:
    camera = CAMERAS["barrel"].undistorted()
    assert camera.distortion == (0, 0, 0, 0)
    np.testing.assert_allclose(camera.px_from_cam([[0.5, 0.25, 1.0]]), [[510 + 450, 390 + 226.25]])


def test_no_points() -> None:
    assert CAMERAS["barrel"].rays(np.zeros((0, 2))).shape == (0, 3)
    assert CAMERAS["barrel"].px_from_cam(np.zeros((0, 3))).shape == (0, 2)


@pytest.mark.parametrize("change", [{"fx": 0.0}, {"fy": np.nan}, {"width": 0}, {"distortion": (np.inf, 0, 0, 0)}])
def test_refuses_what_is_no_camera(change: dict[str, float]) -> None:
    values = {"width": 10, "height": 10, "fx": 9.0, "fy": 9.0, "cx": 5.0, "cy": 5.0} | change
    with pytest.raises(DegenerateGeometry):
        Intrinsics(**values)  # type: ignore[arg-type]
