# SPDX-License-Identifier: Apache-2.0
"""Cameras that move while they take a photo: rolling shutter, row by row, and blur along the motion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.types import Camera

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

BLUR_DEPTH_M = 10.0  # of what the direction of the blur is computed for: facades are about that far away
KERNEL_SAMPLES = 65


@dataclass(frozen=True)
class Motion:
    """How a camera moves. Its pose is that of the middle row's time.

    Attributes:
        velocity_m_s: east, north, up.
        turn_deg_s: rates of rotation about the camera's own axes, to the right, down and ahead.
        readout_s: from the first row to the last one; 0 is a global shutter.
        blur_px: length of the blur at the middle of the photo, in the direction in which the picture moves.
    """

    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    readout_s: float = 0.0
    blur_px: float = 0.0


STILL = Motion()


def swept_rays(camera: Camera, rays: Array32, motion: Motion) -> tuple[Array32, Array32]:
    """Origins and directions (n, 3) in the world of a photo's rays (n, 3) in the camera, given in rows from the top.

    n is the number of rows, a multiple of the photo's height, times that of columns.
    """
    samples = round(float(np.sqrt(len(rays) / (camera.intrinsics.width * camera.intrinsics.height))))
    rows = camera.intrinsics.height * samples
    at_s = ((np.arange(rows) + 0.5) / rows - 0.5) * motion.readout_s
    turned = Rotation.from_rotvec(np.radians(motion.turn_deg_s) * at_s[:, None]).as_matrix()
    world_from_row = np.einsum("ji,njk->nik", camera.cam_from_world.rotation, turned).astype(np.float32)
    directions = np.einsum("nij,nkj->nki", world_from_row, rays.reshape(rows, -1, 3))
    origins = (camera.centre + np.array(motion.velocity_m_s) * at_s[:, None]).astype(np.float32)
    return np.repeat(origins, directions.shape[1], axis=0), directions.reshape(-1, 3)


def blurred(light: Array32, camera: Camera, motion: Motion) -> Array32:
    """A photo's light (h, w, 3), averaged along the motion over `motion.blur_px`."""
    flow = _flow(camera, motion)
    length = float(np.linalg.norm(flow))
    if motion.blur_px <= 0 or length == 0:
        return light
    kernel = _line(motion.blur_px * flow / length)
    return np.asarray(cv2.filter2D(light, -1, kernel, borderType=cv2.BORDER_REFLECT), dtype=np.float32)


def _flow(camera: Camera, motion: Motion) -> Array:
    """Direction (2,) in which the middle of the picture moves: radians per second to the right and down."""
    velocity = camera.cam_from_world.rotation @ np.array(motion.velocity_m_s)
    turn = np.radians(motion.turn_deg_s)
    return np.array([-turn[1] - velocity[0] / BLUR_DEPTH_M, turn[0] - velocity[1] / BLUR_DEPTH_M])


def _line(along_px: Array) -> Array32:
    """A kernel of sum 1: a straight line of that vector (2,) through the middle."""
    half = int(np.ceil(np.abs(along_px).max() / 2)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    points = half + (np.arange(KERNEL_SAMPLES) / (KERNEL_SAMPLES - 1) - 0.5)[:, None] * along_px
    left = np.floor(points).astype(int)
    share = points - left
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1])
            np.add.at(kernel, (left[:, 1] + dy, left[:, 0] + dx), weight)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)
