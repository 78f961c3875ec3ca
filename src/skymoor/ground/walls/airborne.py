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

from skymoor.densify import empty_depth_map
from skymoor.engines.options import FIXED
from skymoor.errors import DegenerateGeometry
from skymoor.geo import Grid
from skymoor.geometry import Similarity
from skymoor.ground.plan_view import PlanSearchOptions, PlanTarget, colour_map, plan_target
from skymoor.ground.surface import surface_of
from skymoor.ground.wall_planes import Wall, WallOptions, find_walls
from skymoor.ground.walls.consensus import AcceptanceOptions
from skymoor.ground.walls.facade_pairs import FacadePairOptions
from skymoor.ground.walls.facade_search import FacadeSearchOptions
from skymoor.ground.walls.facades import Facade, FacadeOptions, facade_of
from skymoor.ground.walls.pool import PoolOptions
from skymoor.ground.walls.refine import PerturbationOptions, RefineOptions
from skymoor.ground.walls.roof_edges import RoofEdgeOptions, SurfaceImage, roof_edge_walls, without_repeated
from skymoor.ground.walls.roof_facades import RoofFacadeOptions, roof_facades
from skymoor.ground.walls.shifts import ShiftOptions
from skymoor.ground.walls.visibility import HeightRaster, height_raster_of
from skymoor.match import CyclicOptions, DenseMatcher, PointMatcher, StructuralMatcher
from skymoor.match.overlay import render_bounds, warp_confidence, warp_to_grid
from skymoor.registration import RegisterOptions
from skymoor.registration.detail import averaged
from skymoor.types import Camera, DepthMap, Photos, Progress, Reference, Render, no_progress

WORTH = 0.05  # confidence of the render that widens its surface
PICTURE_PIXELS = 2e8  # of all photos that colour walls together: 3 GB
MEASURED = 0.2  # confidence from which a height is measured and not interpolated


@dataclass(frozen=True)
class GroundOptions:
    """Registration of a ground component to the airborne model.

    Attributes:
        pixel_m, ground_pixel_m: pixels of the orthophotos of airborne and of ground walls.
        searched_walls: largest walls of the ground model that are searched on all airborne ones.
        min_scale, max_scale: metres per unit of the ground model that are searched. A levelled component has the
            cameras' height above the ground for its unit: 0.5 to 8 m; little ground is visible in front of a wall.
        max_blocked: share of the viewing rays of a hypothesis that may cross walls.
        max_angle_deg, max_gap_m: a ground wall and an airborne wall this close are matched densely.
        shifts, rotations_deg: poses around each hypothesis among which the best is taken first.
        finalists: hypotheses that are refined as a whole with all photos; those elsewhere than the best show chance.
        matched: the best of these at different places, which are refined with dense matches too.
        rounds: of that refinement, each from the end of the last one.
        screen, refine, perturbation: how finalists and matched hypotheses are refined as a whole, and compared with
            positions around.
        min_kept: share of that agreement that must remain after the final fit to the matches.
        picture_px: largest long side of the photos that colour walls below roof edges.
        max_dsm_m: pixels of a DSM up to which its height steps are roof edges too.
        plan_cell_m: of the search in plan.
        key_points: what matches those of walls; None where there is no learned matcher.
        edges, roof_facades, plan, walls, airborne_facades, ground_facades, search, pool, dense, cyclic, register,
            facade_pairs, acceptance: of the steps.
    """

    pixel_m: float = 0.2
    ground_pixel_m: float = 0.1
    searched_walls: int = 5
    min_scale: float = 0.5
    max_scale: float = 8.0
    max_blocked: float = field(default=0.1, metadata=FIXED)
    max_angle_deg: float = field(default=12.0, metadata=FIXED)
    max_gap_m: float = field(default=1.5, metadata=FIXED)
    shifts: ShiftOptions = field(default_factory=ShiftOptions, metadata=FIXED)
    rotations_deg: tuple[float, ...] = field(default=(-4.0, -2.0, 0.0, 2.0, 4.0), metadata=FIXED)
    finalists: int = 20
    matched: int = 5
    rounds: int = field(default=2, metadata=FIXED)
    min_kept: float = field(default=0.7, metadata=FIXED)
    screen: RefineOptions = field(default_factory=lambda: RefineOptions(trials=32, sizes=(2.5,)), metadata=FIXED)
    refine: RefineOptions = field(default_factory=RefineOptions, metadata=FIXED)
    perturbation: PerturbationOptions = field(default_factory=PerturbationOptions, metadata=FIXED)
    picture_px: int = field(default=2000, metadata=FIXED)
    max_dsm_m: float = field(default=1.0, metadata=FIXED)
    plan_cell_m: float = field(default=0.75, metadata=FIXED)
    edges: RoofEdgeOptions = field(default_factory=RoofEdgeOptions, metadata=FIXED)
    roof_facades: RoofFacadeOptions = field(default_factory=RoofFacadeOptions, metadata=FIXED)
    plan: PlanSearchOptions = field(default_factory=PlanSearchOptions, metadata=FIXED)
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
    key_points: PointMatcher | None = field(default=None, metadata=FIXED)
    acceptance: AcceptanceOptions = field(default_factory=AcceptanceOptions)


@dataclass(frozen=True, eq=False)
class AirborneWalls:
    """The target of ground components: walls with orthophotos, heights seen from above, and these in plan, in ENU."""

    facades: tuple[Facade, ...]
    heights: HeightRaster
    plan: PlanTarget


@dataclass(frozen=True, eq=False)
class AirborneModel:
    """A registered airborne component: depth maps, cameras and nadir render in its level frame, and where that is."""

    maps_level: Sequence[DepthMap]
    cameras: Sequence[Camera]
    render: Render
    enu_from_level: Similarity


def airborne_walls(
    maps_enu: Sequence[DepthMap],
    options: GroundOptions | None = None,
    *,
    surfaces: Sequence[SurfaceImage] = (),
    pictures_enu: Sequence[DepthMap] = (),
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> AirborneWalls:
    """Prepare an airborne component, once for all ground components.

    Walls come from the depth maps where these hold any, and from the roof edges of the surfaces seen from above.

    Args:
        maps_enu: depth maps.
        options: see there.
        surfaces: the same from above, the largest first.
        pictures_enu: photos that colour the walls below roof edges; without depths, as fine as possible.
        rng: for the walls of the depth maps.
        progress: counts walls.

    Raises `DegenerateGeometry` when its depth maps show no surface from above.
    """
    options = options or GroundOptions()
    surface = surface_of(maps_enu)
    heights = height_raster_of(surface)
    walls = find_walls(surface, options.walls, rng=rng)
    roofs = [wall for one in surfaces for wall in roof_edge_walls(one, options.edges)]
    edges = without_repeated(roofs, walls, options.edges)
    facades = []
    for done, wall in enumerate(walls):
        facades.append(facade_of(wall, maps_enu, options.pixel_m, options.airborne_facades))
        progress(done + 1, len(walls) + len(edges))
    facades += roof_facades(edges, pictures_enu, heights, options.pixel_m, options.roof_facades)
    progress(len(walls) + len(edges), len(walls) + len(edges))
    return AirborneWalls(tuple(facades), heights, _plan(surfaces, heights, roofs, options.plan_cell_m))


def _plan(surfaces: Sequence[SurfaceImage], heights: HeightRaster, edges: Sequence[Wall], cell_m: float) -> PlanTarget:
    """The largest surface in plan, or the cells of heights without any."""
    if not surfaces:
        rows = heights.height.shape[0]
        grid = Grid(heights.x0, heights.y0 + rows * heights.cell_m, heights.cell_m, heights.height.shape)
        return plan_target(np.where(heights.seen, heights.height, np.nan)[::-1].astype(np.float32), grid, walls=edges)
    largest = surfaces[0]
    step = max(1, round(cell_m / largest.grid.pixel_m))
    up, grid = averaged(largest.up, step), largest.grid
    seen = averaged(largest.seen.astype(np.float32), step) > 0.5
    shown = np.where(np.isfinite(largest.up)[..., None], largest.rgb, np.nan).astype(np.float32)
    rgb = np.dstack([averaged(shown[..., k], step) for k in range(3)])
    colour = colour_map(np.nan_to_num(rgb), np.isfinite(rgb[..., 0]))
    coarse = Grid(grid.east0, grid.north0, step * grid.pixel_m, up.shape)
    return plan_target(up, coarse, seen=seen, walls=edges, colour=colour)


def walls_of_components(
    models: Sequence[AirborneModel],
    photos: Photos,
    options: GroundOptions | None = None,
    *,
    reference: Reference | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> AirborneWalls | None:
    """`airborne_walls` of several components, the largest first; None without any surface.

    Roof edges that the components do not show come from the reference, where its DSM is fine enough to have them.
    """
    if not models:
        return None
    options = options or GroundOptions()
    maps = [transformed_depth_map(one, model.enu_from_level) for model in models for one in model.maps_level]
    cameras = [camera.transformed(model.enu_from_level) for model in models for camera in model.cameras]
    picture_px = min(options.picture_px, int(np.sqrt(PICTURE_PIXELS / len(cameras))))
    pictures = [empty_depth_map(camera, photos, picture_px) for camera in cameras]
    surfaces = [_surface(model) for model in models]
    if reference is not None and reference.dsm_pixel_m <= options.max_dsm_m:
        surfaces.append(_of_reference(reference, surfaces))
    rng = np.random.default_rng(seed)
    try:
        return airborne_walls(maps, options, surfaces=surfaces, pictures_enu=pictures, rng=rng, progress=progress)
    except DegenerateGeometry:
        return None


def _surface(model: AirborneModel) -> SurfaceImage:
    """Colours and heights of the nadir render, as fine as it is."""
    west, south, east, north = render_bounds(model.render, model.enu_from_level, WORTH)
    pixel = model.render.view.pixel * model.enu_from_level.scale
    shape = (max(int(np.ceil((north - south) / pixel)), 1), max(int(np.ceil((east - west) / pixel)), 1))
    grid = Grid(west, north, pixel, shape)
    raster, up = warp_to_grid(model.render, model.enu_from_level, grid, 0.0)
    seen = warp_confidence(model.render, model.enu_from_level, grid) >= MEASURED
    return SurfaceImage(grid, raster.rgb, up, seen)


def _of_reference(reference: Reference, surfaces: Sequence[SurfaceImage]) -> SurfaceImage:
    """Orthophoto and DSM where the surfaces are."""
    bounds = np.array([surface.grid.bounds for surface in surfaces])
    part = reference.part([*bounds[:, :2].min(axis=0), *bounds[:, 2:].max(axis=0)])
    return SurfaceImage(part.grid, part.rgb, part.height, np.isfinite(part.height))


def transformed_depth_map(depth_map: DepthMap, target_from_source: Similarity) -> DepthMap:
    """A depth map in another frame; depths and their uncertainty take the unit of that frame."""
    scale = np.float32(target_from_source.scale)
    return replace(
        depth_map,
        camera=depth_map.camera.transformed(target_from_source),
        depth=depth_map.depth * scale,
        sigma=depth_map.sigma * scale,
    )
