# SPDX-License-Identifier: Apache-2.0
"""Photos at the size of depth maps: reduced, and without distortion."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.types import Camera, DepthMap, Image, Photos


def reduced(camera: Camera, image: Image, max_px: int) -> tuple[Camera, Image]:
    """A camera and its photo with a long side of at most `max_px`."""
    i = camera.intrinsics
    ratio = min(1.0, max_px / max(i.width, i.height))
    size = (round(i.width * ratio), round(i.height * ratio))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if ratio < 1 else image
    return Camera(camera.image, i.resized(*size), camera.cam_from_world), small


def undistorted(camera: Camera, image: Image) -> tuple[Camera, Image]:
    """The pinhole camera of the same size and focal length, and its image."""
    i, pinhole = camera.intrinsics, camera.intrinsics.undistorted()
    rgb = cv2.undistort(image, i.matrix_cv(), np.array(i.distortion), None, pinhole.matrix_cv())
    return Camera(camera.image, pinhole, camera.cam_from_world), rgb


def empty_depth_map(camera: Camera, photos: Photos, max_px: int) -> DepthMap:
    """A depth map without known depths, for a camera without stereo partners."""
    pinhole, rgb = undistorted(*reduced(camera, photos.read(camera.image), max_px))
    unknown = np.full(rgb.shape[:2], np.nan, np.float32)
    return DepthMap(pinhole, unknown, unknown, np.zeros(rgb.shape[:2], np.uint8), rgb)
