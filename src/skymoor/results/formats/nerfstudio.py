# SPDX-License-Identifier: Apache-2.0
"""Cameras as nerfstudio's transforms.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skymoor.geo import EnuFrame
from skymoor.types import Camera


def nerfstudio_transforms(
    cameras_enu: Sequence[Camera], paths: Mapping[str, str], frame: EnuFrame, cloud: str | None = None
) -> dict[str, object]:
    """transforms.json of cameras in ENU metres; `paths` gives the file of each image, `cloud` that of their points.

    nerfstudio moves the points of `ply_file_path` as it moves the poses, so they are in the same frame.

    Poses are world-from-camera with OpenGL's axes (x right, y up, z backwards); the world is east, north, up, which is
    nerfstudio's z-up, so `applied_transform` is the identity. The principal point has COLMAP's convention, as theirs:
    the centre of the first pixel is (0.5, 0.5). The origin on Earth is in `enu_origin`, which nerfstudio ignores.
    """
    named = {} if cloud is None else {"ply_file_path": cloud}
    return named | {
        "camera_model": "OPENCV",
        "applied_transform": np.eye(4)[:3].tolist(),
        "enu_origin": {"lat": frame.lat_deg, "lon": frame.lon_deg, "height": frame.height_m},
        "frames": [_frame(camera, paths[camera.image]) for camera in cameras_enu],
    }


def _frame(camera: Camera, path: str) -> dict[str, object]:
    i = camera.intrinsics
    world_from_cam = np.eye(4)
    # Camera axes: OpenGL has y up and looks along -z; here y is down and the view along z.
    world_from_cam[:3, :3] = camera.cam_from_world.rotation.T * [1.0, -1.0, -1.0]
    world_from_cam[:3, 3] = camera.centre
    k1, k2, p1, p2 = i.distortion
    lens = {"fl_x": i.fx, "fl_y": i.fy, "cx": i.cx, "cy": i.cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2}
    pose = {"transform_matrix": world_from_cam.tolist()}
    return {"file_path": path, "w": i.width, "h": i.height} | lens | pose
