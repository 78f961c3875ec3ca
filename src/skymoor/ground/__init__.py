# SPDX-License-Identifier: Apache-2.0
"""Ground photos onto the airborne model: what several stages do together (paper, section 3.4)."""

from skymoor.ground.answers import Answers, OneAnswer, WallAnswers
from skymoor.ground.cameras import CameraOptions, CameraWitness, hear_cameras
from skymoor.ground.joint import JointOptions, conflict, decide_jointly
from skymoor.ground.picture import walls_picture
from skymoor.ground.search import search_ground
from skymoor.ground.walls import AirborneWalls, GroundOptions, airborne_walls, moved_map

__all__ = [
    "AirborneWalls",
    "Answers",
    "CameraOptions",
    "CameraWitness",
    "GroundOptions",
    "JointOptions",
    "OneAnswer",
    "WallAnswers",
    "airborne_walls",
    "conflict",
    "decide_jointly",
    "hear_cameras",
    "moved_map",
    "search_ground",
    "walls_picture",
]
