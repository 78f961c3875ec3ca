# SPDX-License-Identifier: Apache-2.0
"""Trajectories in the format of TUM's RGB-D benchmark, which evo and SLAM tools read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skymoor.geo import EnuFrame
from skymoor.types import Camera


def tum_trajectory(cameras_enu: Sequence[Camera], seconds: Sequence[float], frame: EnuFrame) -> str:
    """Lines of `timestamp tx ty tz qx qy qz qw`, in the order of the time; comments name the origin.

    The pose is world-from-camera: the centre in metres east, north, up, and the rotation that takes the camera's axes
    (x right, y down, z forward) to those (TUM, "File formats" of the RGB-D benchmark). `seconds` are one a camera.
    """
    lines = [
        "# timestamp tx ty tz qx qy qz qw",
        f"# metres east, north, up of WGS 84 latitude {frame.lat_deg!r} longitude {frame.lon_deg!r} "
        f"ellipsoidal height {frame.height_m!r}",
    ]
    for k in np.argsort(seconds, kind="stable"):
        camera = cameras_enu[k]
        qw, qx, qy, qz = camera.cam_from_world.inverse().quaternion_wxyz
        numbers = " ".join(f"{value:.9f}" for value in (*camera.centre, qx, qy, qz, qw))
        lines.append(f"{seconds[k]:.6f} {numbers}")
    return "\n".join(lines) + "\n"


def tum_images(cameras_enu: Sequence[Camera], seconds: Sequence[float]) -> str:
    """Lines of `timestamp filename`, as TUM's rgb.txt."""
    order = np.argsort(seconds, kind="stable")
    return "\n".join(["# timestamp filename", *(f"{seconds[k]:.6f} {cameras_enu[k].image}" for k in order)]) + "\n"
