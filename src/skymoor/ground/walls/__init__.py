# SPDX-License-Identifier: Apache-2.0
"""Ground components on the airborne model by their walls."""

from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions, airborne_walls, moved_map, walls_of_components
from skymoor.ground.walls.answers import WallAnswers
from skymoor.ground.walls.camera_check import CameraOptions, CameraWitness, check_ground_poses, hear_cameras
from skymoor.ground.walls.consensus import Candidate, Guess, JudgeOptions, PoolOptions, judge_ground, pool_guesses
from skymoor.ground.walls.facade_pairs import Counterpart, CounterpartOptions, counterparts
from skymoor.ground.walls.facades import Facade, FacadeOptions, affine_between, facade_of, similarity_between
from skymoor.ground.walls.figure import walls_picture
from skymoor.ground.walls.search import search_ground
from skymoor.ground.walls.shifts import Drift, FacadeSearchOptions, Shift, agreement, drift, search_shifts
from skymoor.ground.walls.surface import Surface, surface_of
from skymoor.ground.walls.visibility import Relief, Sight, SightCheck, check_sight, relief_of, sight_of
from skymoor.ground.walls.walls import Wall, WallOptions, find_walls, moved_wall

__all__ = [
    "AirborneWalls",
    "CameraOptions",
    "CameraWitness",
    "Candidate",
    "Counterpart",
    "CounterpartOptions",
    "Drift",
    "Facade",
    "FacadeOptions",
    "FacadeSearchOptions",
    "GroundOptions",
    "Guess",
    "JudgeOptions",
    "PoolOptions",
    "Relief",
    "Shift",
    "Sight",
    "SightCheck",
    "Surface",
    "Wall",
    "WallAnswers",
    "WallOptions",
    "affine_between",
    "agreement",
    "airborne_walls",
    "check_ground_poses",
    "check_sight",
    "counterparts",
    "drift",
    "facade_of",
    "find_walls",
    "hear_cameras",
    "judge_ground",
    "moved_map",
    "moved_wall",
    "pool_guesses",
    "relief_of",
    "search_ground",
    "search_shifts",
    "sight_of",
    "similarity_between",
    "surface_of",
    "walls_of_components",
    "walls_picture",
]
