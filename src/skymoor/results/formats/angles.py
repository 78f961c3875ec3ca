# SPDX-License-Identifier: Apache-2.0
"""Attitude angles of a camera as Pix4D, Metashape, RealityScan and ODM count them, and as DJI does."""

from __future__ import annotations

import numpy as np

from skymoor.geometry import Similarity
from skymoor.results.tables import CameraRow
from skymoor.types import Array

NED_FROM_ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
# Axes of an aircraft whose camera looks down: forward is the upper edge of the image, right its right, down the view.
CAM_FROM_BODY = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
LOCKED = 1e-7  # cosine of the pitch below which yaw and roll turn about the same axis
MOST_GIMBAL_ROLL_DEG = 3.0


def rotation_of(row: CameraRow) -> Array | None:
    """Camera from ENU (3, 3), camera axes x right, y down, z forward; None where it is not known."""
    quaternion = (row.qw, row.qx, row.qy, row.qz)
    if any(value is None for value in quaternion):
        return None
    return Similarity.from_quaternion_wxyz(1.0, np.array(quaternion, float), np.zeros(3)).rotation


def yaw_pitch_roll_deg(cam_from_enu: Array) -> tuple[float, float, float]:
    """Angles of a camera, degrees, of a rotation (3, 3) as `rotation_of` gives.

    North-east-down axes are turned by yaw, pitch and roll, in this order and about the turned axes, into those of an
    aircraft whose camera looks down with the upper edge of the image forward. So all angles are 0 for a camera that
    looks straight down with north at the top; yaw is the direction of the upper edge, clockwise; pitch 90 looks at the
    horizon in that direction; a positive roll lifts the left side. This is the definition of Pix4D (its article on yaw,
    pitch, roll and omega, phi, kappa), Metashape, RealityScan (heading, pitch, roll) and ODM. ODM adds 90 to the gimbal
    pitch of some makers' photos for this, but takes geo.txt as it is (opendm/photo.py, opendm/geo.py; issue 1473 and
    pull request 1546 of OpenDroneMap/ODM).
    """
    turn = NED_FROM_ENU @ cam_from_enu.T @ CAM_FROM_BODY
    pitch = np.arcsin(np.clip(-turn[2, 0], -1, 1))
    if np.hypot(turn[0, 0], turn[1, 0]) < LOCKED:
        # A camera that looks exactly at the horizon: yaw takes all of the turn about the vertical, as people expect.
        yaw, roll = np.arctan2(-turn[0, 1], turn[1, 1]), 0.0
    else:
        yaw = np.arctan2(turn[1, 0], turn[0, 0])
        roll = np.arctan2(turn[2, 1], turn[2, 2])
    return float(np.degrees(yaw)), float(np.degrees(pitch)), float(np.degrees(roll))


def angle_cells(row: CameraRow) -> list[str]:
    """Yaw, pitch and roll for a table, degrees; three empty cells where they are not known."""
    rotation = rotation_of(row)
    return [""] * 3 if rotation is None else [f"{one:.5f}" for one in yaw_pitch_roll_deg(rotation)]


def gimbal_deg(cam_from_enu: Array) -> tuple[float, float] | None:
    """Yaw and pitch of a DJI gimbal that holds the camera without roll; None where it is rolled by more than 3 degrees.

    DJI's pitch is 0 at the horizon and -90 straight down. Its roll is about the line of sight, that of Pix4D about the
    upper edge of the image, and readers of DJI's tags take one for the other: they add 90 to the pitch and keep the
    rest. Without roll, which a gimbal keeps at 0, both agree; so that of the two which is smaller is dropped. Straight
    down, where yaw and roll of DJI's are one, yaw is then that of the upper edge.
    """
    yaw, pitch, roll = yaw_pitch_roll_deg(cam_from_enu)
    right, down, sight = (NED_FROM_ENU @ axis for axis in cam_from_enu)
    about_sight = np.degrees(np.arctan2(right[2], down[2]))
    if abs(roll) <= abs(about_sight):
        return (yaw, pitch - 90.0) if abs(roll) <= MOST_GIMBAL_ROLL_DEG else None
    if abs(about_sight) > MOST_GIMBAL_ROLL_DEG:
        return None
    return float(np.degrees(np.arctan2(sight[1], sight[0]))), float(np.degrees(-np.arcsin(np.clip(sight[2], -1, 1))))
