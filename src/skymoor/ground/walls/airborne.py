# SPDX-License-Identifier: Apache-2.0
"""Registration of ground photos to the airborne model by walls, without a learned matcher (paper section 3.4).

Local features do not match between airborne and ground photos. Walls do: both models have them, vertical and planar,
and the orthophoto of a wall looks alike from near and from far. Each ground wall is searched on each airborne wall; the
hypotheses on which the walls of a component agree are refined by dense matches; the one that explains best what all
photos show of all airborne walls is accepted, if it passes the criteria and no other is nearly as good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skymoor.engines.options import FIXED
from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.walls.consensus import AcceptanceOptions, PoolOptions
from skymoor.ground.walls.facade_pairs import FacadePairOptions
from skymoor.ground.walls.facade_search import FacadeSearchOptions
from skymoor.ground.walls.facades import Facade, FacadeOptions, facade_of
from skymoor.ground.walls.refine import PerturbationOptions, RefineOptions
from skymoor.ground.walls.surface import surface_of
from skymoor.ground.walls.visibility import HeightRaster, height_raster_of
from skymoor.ground.walls.walls import WallOptions, find_walls
from skymoor.match import CyclicOptions, DenseMatcher, StructuralMatcher
from skymoor.registration import RegisterOptions
from skymoor.types import DepthMap, Progress, no_progress


@dataclass(frozen=True)
class GroundOptions:
    """Registration of a ground component to the airborne model.

    Attributes:
        pixel_m, ground_pixel_m: pixels of the orthophotos of airborne and of ground walls.
        searched_walls: largest walls of the ground model that are searched on all airborne ones.
        min_scale, max_scale: metres per unit of the ground model that are searched. A levelled component has the
            cameras' height above the ground for its unit, but little ground is visible in front of a wall, so that the
            unit may be off by half.
        max_blocked: share of the viewing rays of a hypothesis that may cross walls.
        max_angle_deg, max_gap_m: a ground wall and an airborne wall this close are matched densely.
        finalists: hypotheses that are refined with all photos.
        rounds: of that refinement, each from the end of the last one.
        refine, perturbation: each of them is then refined as a whole, and compared with positions around.
        min_kept: share of that agreement that must remain after the final fit to the matches.
        walls, airborne_facades, ground_facades, search, pool, dense, cyclic, register, facade_pairs, acceptance: of the
            steps.
    """

    pixel_m: float = 0.2
    ground_pixel_m: float = 0.1
    searched_walls: int = 5
    min_scale: float = 0.6
    max_scale: float = 2.6
    max_blocked: float = field(default=0.1, metadata=FIXED)
    max_angle_deg: float = field(default=12.0, metadata=FIXED)
    max_gap_m: float = field(default=1.5, metadata=FIXED)
    finalists: int = 4
    rounds: int = field(default=2, metadata=FIXED)
    min_kept: float = field(default=0.7, metadata=FIXED)
    refine: RefineOptions = field(default_factory=RefineOptions, metadata=FIXED)
    perturbation: PerturbationOptions = field(default_factory=PerturbationOptions, metadata=FIXED)
    walls: WallOptions = field(default_factory=WallOptions, metadata=FIXED)
    airborne_facades: FacadeOptions = field(default_factory=FacadeOptions, metadata=FIXED)
    ground_facades: FacadeOptions = field(
        default_factory=lambda: FacadeOptions(margin_m=4.0, no_depth_margin_m=4.0), metadata=FIXED
    )
    search: FacadeSearchOptions = field(default_factory=FacadeSearchOptions, metadata=FIXED)
    pool: PoolOptions = field(default_factory=PoolOptions, metadata=FIXED)
    dense: DenseMatcher = field(default_factory=StructuralMatcher, metadata=FIXED)
    cyclic: CyclicOptions = field(default_factory=lambda: CyclicOptions(max_matches=1500), metadata=FIXED)
    register: RegisterOptions = field(
        default_factory=lambda: RegisterOptions(inlier_m=0.5, correlation_m=3.0, tilt_sigma_deg=1.0), metadata=FIXED
    )
    facade_pairs: FacadePairOptions = field(default_factory=FacadePairOptions, metadata=FIXED)
    acceptance: AcceptanceOptions = field(default_factory=AcceptanceOptions)


@dataclass(frozen=True, eq=False)
class AirborneWalls:
    """The target of ground components: walls with orthophotos, and heights seen from above, in ENU metres."""

    facades: tuple[Facade, ...]
    heights: HeightRaster


def airborne_walls(
    maps_enu: Sequence[DepthMap],
    options: GroundOptions | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> AirborneWalls:
    """Prepare an airborne component, once for all ground components.

    Raises `DegenerateGeometry` when its depth maps show no surface from above.
    """
    options = options or GroundOptions()
    surface = surface_of(maps_enu)
    walls = find_walls(surface, options.walls, rng=rng)
    facades = []
    for done, wall in enumerate(walls):
        facades.append(facade_of(wall, maps_enu, options.pixel_m, options.airborne_facades))
        progress(done + 1, len(walls))
    return AirborneWalls(tuple(facades), height_raster_of(surface))


def walls_of_components(
    components: Sequence[tuple[Sequence[DepthMap], Similarity]],
    options: GroundOptions | None = None,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> AirborneWalls | None:
    """`airborne_walls` of several components, of each its depth maps and ENU from their frame; None without surface."""
    maps_enu = [
        transformed_depth_map(depth_map, enu_from_level) for maps, enu_from_level in components for depth_map in maps
    ]
    try:
        return airborne_walls(maps_enu, options, rng=np.random.default_rng(seed), progress=progress)
    except DegenerateGeometry:
        return None


def transformed_depth_map(depth_map: DepthMap, target_from_source: Similarity) -> DepthMap:
    """A depth map in another frame; depths and their uncertainty take the unit of that frame."""
    scale = np.float32(target_from_source.scale)
    return replace(
        depth_map,
        camera=depth_map.camera.transformed(target_from_source),
        depth=depth_map.depth * scale,
        sigma=depth_map.sigma * scale,
    )
