# SPDX-License-Identifier: Apache-2.0
"""Ground photos onto the airborne model: what several stages do together (paper, section 3.4)."""

from skymoor.ground.cameras import CameraOptions, CameraWitness, hear_cameras
from skymoor.ground.picture import walls_picture
from skymoor.ground.walls import AirborneWalls, GroundOptions, airborne_walls, moved_map, register_ground

__all__ = [
    "AirborneWalls",
    "CameraOptions",
    "CameraWitness",
    "GroundOptions",
    "airborne_walls",
    "hear_cameras",
    "moved_map",
    "register_ground",
    "walls_picture",
]
