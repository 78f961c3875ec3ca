# SPDX-License-Identifier: Apache-2.0
"""Ground components on the airborne model by their walls."""

from skymoor.ground.surface import Surface, surface_of
from skymoor.ground.wall_planes import Wall, WallOptions, find_walls, transformed_wall
from skymoor.ground.walls.airborne import (
    AirborneModel,
    AirborneWalls,
    GroundOptions,
    airborne_walls,
    transformed_depth_map,
    walls_of_components,
)
from skymoor.ground.walls.consensus import AcceptanceOptions, RefinedHypothesis, decide_ground
from skymoor.ground.walls.facade_pairs import FacadePair, FacadePairOptions, pair_facades
from skymoor.ground.walls.facade_search import (
    Drift,
    FacadeHypothesis,
    FacadeSearchOptions,
    agreement,
    drift,
    search_facades,
)
from skymoor.ground.walls.facades import Facade, FacadeOptions, affine_between, facade_of, similarity_between
from skymoor.ground.walls.figure import walls_figure
from skymoor.ground.walls.hypotheses import WallHypotheses
from skymoor.ground.walls.pool import PoolOptions, WallHypothesis, pool_hypotheses
from skymoor.ground.walls.pose_checks import (
    GroundPoseCheck,
    GroundPoseOptions,
    check_ground_poses,
    check_poses_on_walls,
)
from skymoor.ground.walls.search import search_ground
from skymoor.ground.walls.visibility import (
    HeightRaster,
    ViewRays,
    VisibilityCheck,
    check_visibility,
    height_raster_of,
    view_rays_of,
)

__all__ = [
    "AcceptanceOptions",
    "AirborneModel",
    "AirborneWalls",
    "Drift",
    "Facade",
    "FacadeHypothesis",
    "FacadeOptions",
    "FacadePair",
    "FacadePairOptions",
    "FacadeSearchOptions",
    "GroundOptions",
    "GroundPoseCheck",
    "GroundPoseOptions",
    "HeightRaster",
    "PoolOptions",
    "RefinedHypothesis",
    "Surface",
    "ViewRays",
    "VisibilityCheck",
    "Wall",
    "WallHypotheses",
    "WallHypothesis",
    "WallOptions",
    "affine_between",
    "agreement",
    "airborne_walls",
    "check_ground_poses",
    "check_poses_on_walls",
    "check_visibility",
    "decide_ground",
    "drift",
    "facade_of",
    "find_walls",
    "height_raster_of",
    "pair_facades",
    "pool_hypotheses",
    "search_facades",
    "search_ground",
    "similarity_between",
    "surface_of",
    "transformed_depth_map",
    "transformed_wall",
    "view_rays_of",
    "walls_figure",
    "walls_of_components",
]
