# SPDX-License-Identifier: Apache-2.0
"""The method for ground photos on one page (paper, section 3.4): each component is registered to the airborne model.

Without airborne photos it is registered straight to the reference, in plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from skymoor.densify import MetricScale, metric_scale_of_photos
from skymoor.errors import DegenerateGeometry
from skymoor.ground import Hypotheses, OneHypothesis, decide_jointly
from skymoor.ground.plan_view import MapTarget, map_target, plan_figure, search_on_map
from skymoor.ground.tiles import CascadeOptions, ConsensusOptions, cascade, exhaustive, tile_px_for
from skymoor.ground.walls import (
    AirborneModel,
    AirborneWalls,
    GroundOptions,
    check_ground_poses,
    search_ground,
    walls_of_components,
)
from skymoor.model import render_obliques
from skymoor.orient import estimate_ground_gravity, level_from_gravity
from skymoor.pipeline.airborne import densify_component, ground_of, reconstruct_set
from skymoor.pipeline.job import ComponentResult, Job, MapHypothesis, or_else, refused
from skymoor.reconstruct import ReconstructOptions
from skymoor.types import Component, Photos, Registration, Render

T = TypeVar("T", GroundOptions, ConsensusOptions)

CASCADE, EXHAUSTIVE = CascadeOptions().consensus, ConsensusOptions()
"""How matches of tiles become a similarity."""
NO_FACADE = "the airborne photos show no facade; take some at a slant, 20 degrees from vertical or more, on all sides"


@dataclass(frozen=True, eq=False)
class _Airborne:
    """The target of ground components: the largest airborne component, the walls of all, and renders of it."""

    base: ComponentResult
    walls: AirborneWalls | None
    renders: Sequence[Render]


def register_ground_sets(
    jobs: Sequence[Job], airborne: Sequence[ComponentResult], airborne_photos: Photos
) -> list[list[ComponentResult]]:
    """Every component of every set of ground photos, registered to the airborne model or refused (section 3.4)."""
    if not jobs:
        return []
    target = _airborne([item for item in airborne if item.registration.registered], airborne_photos, jobs[0])
    return _register(jobs, target)


def register_ground_sets_on_map(jobs: Sequence[Job]) -> list[list[ComponentResult]]:
    """Every component of every set of ground photos, registered to the reference in plan or refused."""
    if not jobs:
        return []
    options = jobs[0].options.ground.on_map
    return _register(jobs, jobs[0].store.stage("map_target", map_target, jobs[0].reference, options.cell_m))


def _register(jobs: Sequence[Job], target: _Airborne | MapTarget | None) -> list[list[ComponentResult]]:
    levelled = []
    for number, job in enumerate(jobs):
        choices = job.options.ground.reconstruct.stage_options(job.options.engines, shared_camera=False)
        components = _reconstruct_or_none(job, choices)
        levelled += [(number, _level_or_refuse(f"{job.name}-{k}", c, target, job)) for k, c in enumerate(components)]
    searched = [(item, _search_or_refuse(item, target, jobs[n])) for n, item in levelled if target and item.depths]
    decided = _decided(searched)
    on_map = {item.name: _on_map(item, found) for item, found in searched}
    levelled = [(n, replace(item, hypotheses=on_map.get(item.name, []))) for n, item in levelled]
    results = [(n, _check_or_refuse(item, decided.get(item.name), target, jobs[n])) for n, item in levelled]
    return [[item for n, item in results if n == number] for number in range(len(jobs))]


def _reconstruct_or_none(job: Job, choices: ReconstructOptions) -> list[Component]:
    """The components of a set; none where its reconstruction fails: the other sets have their own."""
    stage = f"{job.name}.reconstruct"
    return or_else(lambda: reconstruct_set(stage, job, choices), lambda _: [], f"{job.name}: reconstruction")


def _decided(searched: Sequence[tuple[ComponentResult, Hypotheses]]) -> dict[str, Registration]:
    """The registrations of all searched components, decided jointly, by their names."""
    items, searches = [item for item, _ in searched], [found for _, found in searched]
    names = [item.name for item in items]
    registrations = or_else(
        lambda: decide_jointly(names, searches, [item.depths for item in items]),
        lambda reason: [refused(item.name, item.component, reason).registration for item in items],
        "ground components together",
    )
    return dict(zip(names, registrations, strict=True))


def _level_or_refuse(
    name: str, component: Component, target: _Airborne | MapTarget | None, job: Job
) -> ComponentResult:
    return or_else(lambda: _level(name, component, target, job), lambda reason: refused(name, component, reason), name)


def _search_or_refuse(item: ComponentResult, target: _Airborne | MapTarget, job: Job) -> Hypotheses:
    return or_else(
        lambda: _search(item, target, job),
        lambda reason: OneHypothesis(refused(item.name, item.component, reason).registration),
        item.name,
    )


def _check_or_refuse(
    item: ComponentResult, found: Registration | None, target: _Airborne | MapTarget | None, job: Job
) -> ComponentResult:
    return or_else(
        lambda: _checked(item, found, target, job),
        lambda reason: replace(item, registration=refused(item.name, item.component, reason).registration),
        item.name,
    )


def _on_map(item: ComponentResult, found: Hypotheses) -> list[MapHypothesis]:
    """All hypotheses of a component, accepted or not."""
    on_map, centre = [], np.median([camera.centre for camera in item.component.cameras], axis=0)
    for enu_from_level, score in zip(found.similarities, found.scores, strict=True):
        east, north, _ = enu_from_level.apply(centre[None])[0].tolist()
        rotation = enu_from_level.rotation
        azimuth_deg = -np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0])) % 360
        on_map.append(MapHypothesis(score, east, north, float(azimuth_deg), enu_from_level.scale))
    return on_map


def _airborne(bases: Sequence[ComponentResult], photos: Photos, job: Job) -> _Airborne | None:
    """What is needed of the airborne components; None where no one is registered."""
    if not bases:
        return None
    # The component of most photos is the best determined.
    base = max(bases, key=lambda item: len(item.component.cameras))
    renders = [] if job.options.ground.method == "walls" else _renders(base, job)
    largest_first = sorted(bases, key=lambda item: -len(item.component.cameras))
    models = [_model(item) for item in largest_first if item.render is not None]
    options, progress = job.options.ground.walls, job.track("walls")
    heights = base.registration.heights
    # Roof edges of a DSM are where the model's are only if both have one relief.
    reference = job.reference if heights is not None and heights.status == "CONFIRMED" else None
    walls = job.store.stage(
        "walls", walls_of_components, models, photos, options, reference=reference, seed=job.seed, progress=progress
    )
    return _Airborne(base, walls, renders)


def _model(base: ComponentResult) -> AirborneModel:
    assert base.render is not None and base.registration.enu_from_level is not None
    return AirborneModel(base.depths, base.component.cameras, base.render, base.registration.enu_from_level)


def _renders(base: ComponentResult, job: Job) -> list[Render]:
    """The airborne model from above and from all sides."""
    assert base.render is not None
    options, progress = job.options.render, job.track("oblique views")
    obliques = job.store.stage(f"{base.name}.obliques", render_obliques, base.model, options, progress=progress)
    return [base.render, *obliques]


def _level(name: str, component: Component, target: _Airborne | MapTarget | None, job: Job) -> ComponentResult:
    """A ground component, levelled and with depth maps, not registered yet; without depth maps where a step failed."""
    job.end_of("reconstruct")
    options, engines = job.options.ground, job.options.engines
    try:
        if target is None and not job.stop_after:  # a run that stops has not placed the airborne ones yet
            raise DegenerateGeometry("there is no registered airborne component to register it to")
        ground = ground_of(name, component, engines.labeler(options.labels), job)
        gravity = estimate_ground_gravity(component, job.photos, ground=ground)
        level_from_sfm = level_from_gravity(component, gravity)
        level = component.transformed(level_from_sfm)
        # In memory: the search looks at each of them again and again.
        depths = list(densify_component(name, level, job, engines.stereo(options.densify)))
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    if target is None:
        job.end_of("search")
    found = refused(name, level, "not searched yet")
    base = target.base if isinstance(target, _Airborne) else None
    found = replace(found, level_from_sfm=level_from_sfm, gravity=gravity, depths=depths, base=base)
    return replace(found, metric=_metric(found, job))


def _metric(item: ComponentResult, job: Job) -> MetricScale | None:
    """Metres per unit of a component by monocular metric depth; None where it is not chosen or not conclusive."""
    engine = job.options.engines.metric_scale(job.options.ground.metric)
    if engine is None:
        return None
    progress = job.track(f"{item.name}: metres of single photos")
    return job.store.stage(f"{item.name}.metric", metric_scale_of_photos, item.depths, engine, progress=progress)


def _of_size(options: T, item: ComponentResult) -> T:
    """Options of a search, without the scales that metric depth excludes."""
    if item.metric is None:
        return options
    low, high = item.metric.narrowed(options.min_scale, options.max_scale)
    return replace(options, min_scale=low, max_scale=high)


def _search(item: ComponentResult, target: _Airborne | MapTarget, job: Job) -> Hypotheses:
    """Hypotheses of a component: on the reference, or by the chosen method on the airborne model."""
    if isinstance(target, MapTarget):
        found = _search_map(item, target, job)
        job.end_of("search")
        return found
    if job.options.ground.method != "walls":
        return _search_tiles(item, target, job)
    return _search_walls(item, target, job)


def _search_map(item: ComponentResult, target: MapTarget, job: Job) -> Hypotheses:
    limits, progress = _of_size(job.options.ground.walls, item), job.track(f"{item.name}: places on the map")
    scales, rng = {"min_scale": limits.min_scale, "max_scale": limits.max_scale}, np.random.default_rng(job.seed)
    options, name = job.options.ground.on_map, f"{item.name}.on_map"
    try:
        return job.store.stage(name, search_on_map, item.depths, target, options, **scales, rng=rng, progress=progress)
    except DegenerateGeometry as error:
        return OneHypothesis(refused(item.name, item.component, str(error)).registration)


def _search_walls(item: ComponentResult, airborne: _Airborne, job: Job) -> Hypotheses:
    if airborne.walls is None:
        return OneHypothesis(refused(item.name, item.component, "the airborne model shows no surface").registration)
    if not airborne.walls.facades:
        return OneHypothesis(refused(item.name, item.component, NO_FACADE).registration)
    options, progress = _of_size(job.options.ground.walls, item), job.track(f"{item.name}: walls")
    options = replace(options, key_points=job.options.ground.point_matcher(job.options.engines))
    rng = np.random.default_rng(job.seed)
    return job.store.stage(
        f"{item.name}.search", search_ground, item.depths, airborne.walls, options, rng=rng, progress=progress
    )


def _search_tiles(item: ComponentResult, airborne: _Airborne, job: Job) -> OneHypothesis:
    """Registration of a component by matches of its photos with tiles of the airborne renders."""
    ground, matcher = job.options.ground, job.options.ground.dense_matcher(job.options.engines)
    common: dict[str, Any] = {
        "enu_from_render": airborne.base.registration.enu_from_level,
        "rng": np.random.default_rng(job.seed),
        "progress": job.track(f"{item.name}: tiles"),
    }
    maps, renders, name = item.depths, airborne.renders, f"{item.name}.tiles"
    try:
        if ground.method == "cascade":
            retriever = job.options.engines.retriever(ground.retriever)
            few = replace(ground.cascade, consensus=_consensus(CASCADE, item, airborne), retriever=retriever)
            return OneHypothesis(job.store.stage(name, cascade, maps, renders, matcher, few, **common))
        every = _consensus(EXHAUSTIVE, item, airborne)
        return OneHypothesis(job.store.stage(name, exhaustive, maps, renders, matcher, every, **common))
    except DegenerateGeometry as error:
        return OneHypothesis(refused(item.name, item.component, str(error)).registration)


def _consensus(options: ConsensusOptions, item: ComponentResult, airborne: _Airborne) -> ConsensusOptions:
    """Options of the tile search for a component: its scales, and tiles of its photos' size, where metres are known."""
    options = _of_size(options, item)
    placed = airborne.base.registration.enu_from_level
    if item.metric is None or placed is None or not airborne.renders:
        return options
    pixel_m = airborne.renders[0].view.pixel * placed.scale
    tile_px = tile_px_for(item.depths, item.metric.metres_per_unit, pixel_m)
    return replace(options, pictures=replace(options.pictures, tile_px=tile_px))


def _checked(
    item: ComponentResult, found: Registration | None, target: _Airborne | MapTarget | None, job: Job
) -> ComponentResult:
    """A component with its registration, the pose check of each camera, and a figure of its walls or its plan."""
    if found is None or target is None:
        return item
    item = replace(item, registration=found)
    if isinstance(target, MapTarget) and found.enu_from_level is not None:
        arguments = (item.depths, job.reference, found.enu_from_level, job.seed)
        return replace(item, plan=job.store.stage(f"{item.name}.figure", plan_figure, *arguments))
    if not found.registered or isinstance(target, MapTarget) or target.walls is None:
        return item
    checks, figure = job.store.stage(
        f"{item.name}.cameras",
        check_ground_poses,
        item.component.cameras,
        item.depths,
        job.photos,
        target.walls,
        found.enu_from_level,
        job.options.ground.walls,
        max_px=job.options.engines.stereo(job.options.ground.densify).max_px,
        seed=job.seed,
    )
    return replace(item, walls=figure, pose_checks=tuple(checks))
