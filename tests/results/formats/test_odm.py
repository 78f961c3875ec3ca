# SPDX-License-Identifier: Apache-2.0
"""What OpenDroneMap reads: angles by its convention, one mark a photo, and one name an image."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.results.formats.odm import odm_gcp_list, odm_geo, odm_names
from skymoor.results.tables import CameraRow
from skymoor.types import Component
from support.exported_run import FRAME, cameras


@pytest.mark.parametrize(
    ("right", "down", "forward", "yaw_pitch_roll"),
    [
        ([1, 0, 0], [0, -1, 0], [0, 0, -1], (0, 0, 0)),  # straight down, north at the top
        ([0, -1, 0], [-1, 0, 0], [0, 0, -1], (90, 0, 0)),  # straight down, east at the top
        ([0, -1, 0], [-0.5, 0, -np.sqrt(0.75)], [np.sqrt(0.75), 0, -0.5], (90, 60, 0)),  # to the east, 30 below
    ],
)
def test_angles_of_known_views(
    right: list[float], down: list[float], forward: list[float], yaw_pitch_roll: tuple[float, float, float]
) -> None:
    cam_from_enu = Similarity(1.0, np.array([right, down, forward], float), np.zeros(3))
    turn = dict(zip(("qw", "qx", "qy", "qz"), cam_from_enu.quaternion_wxyz.tolist(), strict=True))
    row = CameraRow("a.jpg", "airborne", 0, "REGISTERED", 1.0, 2.0, 3.0, ce90=2.1, le90=3.8, **turn)
    found = [float(word) for word in odm_geo([row]).split()[5:]]
    np.testing.assert_allclose(found, [*yaw_pitch_roll, 2.1, 3.8], atol=1e-4)


def test_without_a_rotation_no_angles_are_written() -> None:
    """Zeros would say that the camera looks straight down."""
    row = CameraRow("a.jpg", "airborne", 0, "REGISTERED", 1.0, 2.0, 3.0, ce90=2.1, le90=3.8)
    assert odm_geo([row]).splitlines()[1] == "a.jpg 2.0000000000 1.0000000000 3.0000"


def test_a_point_is_marked_once_in_a_photo_where_it_fits_best() -> None:
    three = tuple(cameras()[:3])
    points = np.array([[0.0, 0, 0], [3, 4, 1]])
    px = [camera.intrinsics.px_from_cam(camera.cam_from_world.apply(points)) for camera in three]
    twice = np.array([px[0][0] + 3, px[0][0], px[1][0], px[2][0], px[0][1], px[0][1] + 1, px[1][1]])
    component = Component(
        three,
        points,
        np.zeros((2, 3), np.uint8),
        obs_camera=np.array([0, 0, 1, 2, 0, 0, 1], np.int32),
        obs_point=np.array([0, 0, 0, 0, 1, 1, 1], np.int32),
        obs_px=twice,
        reprojection_px=0.5,
    )
    lines = [line.split() for line in odm_gcp_list(component, FRAME, "x").splitlines()]
    # The second point is in two photos only, though three features show it.
    assert [line[5] for line in lines] == [camera.image.rpartition("/")[2] for camera in three]
    np.testing.assert_allclose([float(word) for word in lines[0][3:5]], px[0][0] - 0.5, atol=1e-3)


def test_photos_of_one_name_in_two_sub_folders_are_told_apart_for_odm() -> None:
    names = odm_names(["air/100MEDIA/a.jpg", "air/101MEDIA/a.jpg", "air/b.jpg", "b/101MEDIA/c.jpg", "a/101MEDIA/c.jpg"])
    assert list(names.values()) == ["100MEDIA_a.jpg", "101MEDIA_a.jpg", "b.jpg", "b_101MEDIA_c.jpg", "a_101MEDIA_c.jpg"]
