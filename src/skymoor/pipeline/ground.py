# SPDX-License-Identifier: Apache-2.0
"""The method for ground photos on one page (paper, section 3.4): each component is laid on the airborne model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

import skymoor.geometry
import skymoor.ground
import skymoor.ground.tiles
import skymoor.ground.walls
import skymoor.match
import skymoor.model
from skymoor.densify import MetricScale, blind_map, scale_from_metric_depth
from skymoor.engines.choice import files_of
from skymoor.engines.weights import stamps
from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.ground import Answers, OneAnswer, decide_jointly
from skymoor.ground.tiles import ConsensusOptions, cascade, exhaustive, tile_px_for
from skymoor.ground.walls import (
    AirborneWalls,
    CameraWitness,
    GroundOptions,
    airborne_walls,
    hear_cameras,
    moved_map,
    search_ground,
    walls_picture,
)
from skymoor.model import oblique_views
from skymoor.orient import estimate_ground_gravity, level_from_gravity
from skymoor.pipeline.airborne import densify_component, ground_of, reconstruct_set
from skymoor.pipeline.job import Hypothesis, Job, Placed, or_else, refused
from skymoor.pipeline.options import GroundSetOptions
from skymoor.types import Component, Image, Registration, Render

T = TypeVar("T", GroundOptions, ConsensusOptions)


@dataclass(frozen=True, eq=False)
class _Airborne:
    """What ground components are laid on: the largest airborne component, the walls of all, and renders of it."""

    base: Placed
    walls: AirborneWalls | None
    renders: Sequence[Render]


def register_ground_sets(jobs: Sequence[Job], airborne: Sequence[Placed]) -> list[list[Placed]]:
    """Every component of every set of ground photos, placed on the airborne model or refused (paper, section 3.4)."""
    if not jobs:
        return []
    ready = _airborne([item for item in airborne if item.registration.registered], jobs[0])
    levelled = []
    for number, job in enumerate(jobs):
        components = reconstruct_set(f"{job.name}.reconstruct", job, job.options.ground.reconstruct)
        levelled += [(number, _level_or_refuse(f"{job.name}-{k}", c, ready, job)) for k, c in enumerate(components)]
    searched = [(item, _search_or_refuse(item, ready, jobs[n])) for n, item in levelled if ready and item.depths]
    names = [item.name for item, _ in searched]
    found = or_else(
        lambda: decide_jointly(
            names,
            [answers for _, answers in searched],
            [item.depths for item, _ in searched],
            jobs[0].options.ground.joint,
        ),
        lambda reason: [refused(item.name, item.component, reason).registration for item, _ in searched],
        "ground components together",
    )
    decided = dict(zip(names, found, strict=True))
    places = {item.name: _hypotheses(item, answers) for item, answers in searched}
    levelled = [(n, replace(item, hypotheses=places.get(item.name, []))) for n, item in levelled]
    placed = [(n, _heard_or_refuse(item, decided.get(item.name), ready, jobs[n])) for n, item in levelled]
    return [[item for n, item in placed if n == number] for number in range(len(jobs))]


def _level_or_refuse(name: str, component: Component, airborne: _Airborne | None, job: Job) -> Placed:
    return or_else(
        lambda: _level(name, component, airborne, job), lambda reason: refused(name, component, reason), name
    )


def _search_or_refuse(item: Placed, airborne: _Airborne, job: Job) -> Answers:
    return or_else(
        lambda: _search(item, airborne, job),
        lambda reason: OneAnswer(refused(item.name, item.component, reason).registration),
        item.name,
    )


def _heard_or_refuse(item: Placed, found: Registration | None, airborne: _Airborne | None, job: Job) -> Placed:
    return or_else(
        lambda: _heard(item, found, airborne, job),
        lambda reason: replace(item, registration=refused(item.name, item.component, reason).registration),
        item.name,
    )


def _hypotheses(item: Placed, answers: Answers) -> list[Hypothesis]:
    """Where a component may stand, believed or not."""
    told, middle = [], np.median([camera.centre for camera in item.component.cameras], axis=0)
    for place, evidence in zip(answers.places, answers.evidence, strict=True):
        east, north, _ = place.apply(middle[None])[0].tolist()
        turn_deg = -np.degrees(np.arctan2(place.rotation[1, 0], place.rotation[0, 0])) % 360
        told.append(Hypothesis(evidence, east, north, float(turn_deg), place.scale))
    return told


def _airborne(bases: Sequence[Placed], job: Job) -> _Airborne | None:
    """What is needed of the airborne components; None where no one is registered."""
    if not bases:
        return None
    # Most photos make the surest ground to stand on.
    base = max(bases, key=lambda item: len(item.component.cameras))
    renders = [] if job.options.ground.method == "walls" else _renders(base, job)
    return _Airborne(base, _walls(bases, job), renders)


def _walls(bases: Sequence[Placed], job: Job) -> AirborneWalls | None:
    """The walls of all registered airborne components; None where they show no surface."""
    options = job.options.ground.place

    def compute() -> AirborneWalls | None:
        transforms = [(base, base.registration.enu_from_level) for base in bases]
        maps = [
            moved_map(m, enu_from_level) for base, enu_from_level in transforms if enu_from_level for m in base.depths
        ]
        try:
            return airborne_walls(maps, options, rng=np.random.default_rng(job.seed), progress=job.track("walls"))
        except DegenerateGeometry:
            return None

    return job.store.stage(
        "walls",
        compute,
        options=(options, job.seed),
        after=[f"{base.name}.{stage}" for base in bases for stage in ("depths", "register")],
        code=[skymoor.ground.walls, skymoor.ground, skymoor.geometry],
    )


def _level(name: str, component: Component, airborne: _Airborne | None, job: Job) -> Placed:
    """A ground component upright and with depth, not placed yet; without depth maps if that is as far as it goes."""
    options = job.options.ground
    try:
        if airborne is None:
            raise DegenerateGeometry("no airborne component is registered that it could be laid on")
        ground = ground_of(name, component, options.labels, job, f"{job.name}.reconstruct")
        gravity = estimate_ground_gravity(component, job.photos, options.upright, ground=ground)
        level_from_sfm = level_from_gravity(component, gravity)
        level = component.moved(level_from_sfm)
        depths = densify_component(name, level, level_from_sfm, job, f"{job.name}.reconstruct", options.densify)
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    found = refused(name, level, "not searched yet")
    found = replace(found, level_from_sfm=level_from_sfm, gravity=gravity, depths=depths, base=airborne.base)
    return replace(found, metric=_metric(found, job))


def _metric(item: Placed, job: Job) -> MetricScale | None:
    """How many metres a unit of a component is, by what single photos say; None where nobody is asked, or can tell."""
    engine = job.options.ground.metric
    if engine.engine is None:
        return None
    progress = job.track(f"{item.name}: metres of single photos")

    def compute() -> MetricScale | None:
        metres = []
        for depth_map in item.depths:
            metres.append(engine(depth_map.rgb, depth_map.camera.intrinsics.fx))
            progress(len(metres), len(item.depths))
        try:
            return scale_from_metric_depth(item.depths, metres)
        except TooFewMatches:
            return None

    return job.store.stage(
        f"{item.name}.metric",
        compute,
        options=(engine.engine, stamps(engine.ready())),
        after=[f"{item.name}.depths"],
        code=[skymoor.densify],
    )


def _of_size(options: T, item: Placed) -> T:
    """Options of a search, without the scales that metric depth denies."""
    if item.metric is None:
        return options
    low, high = item.metric.narrowed(options.min_scale, options.max_scale)
    return replace(options, min_scale=low, max_scale=high)


def _search(item: Placed, airborne: _Airborne, job: Job) -> Answers:
    """Where a component may stand, by the chosen method."""
    options, walls = _of_size(job.options.ground.place, item), airborne.walls
    if job.options.ground.method != "walls":
        return _search_tiles(item, airborne, job)
    if walls is None:
        return OneAnswer(refused(item.name, item.component, "the airborne model shows no surface").registration)
    return job.store.stage(
        f"{item.name}.search",
        lambda: search_ground(
            item.depths,
            walls,
            options,
            rng=np.random.default_rng(job.seed),
            progress=job.track(f"{item.name}: walls"),
        ),
        options=(options, job.seed),
        after=["walls", f"{item.name}.depths"],
        code=[skymoor.ground.walls, skymoor.ground, skymoor.match, "skymoor.registration", skymoor.geometry],
    )


def _search_tiles(item: Placed, airborne: _Airborne, job: Job) -> OneAnswer:
    """Where the tiles of the airborne model's renders say that a component stands."""
    ground, base = job.options.ground, airborne.base
    options, consensus = ground.cascade, _consensus(item, airborne, ground)
    few = ground.method == "cascade"

    def compute() -> OneAnswer:
        common: dict[str, Any] = {
            "enu_from_render": base.registration.enu_from_level,
            "rng": np.random.default_rng(job.seed),
            "progress": job.track(f"{item.name}: tiles"),
        }
        try:
            if few:
                chosen = replace(options, consensus=consensus)
                found = cascade(item.depths, airborne.renders, ground.matcher, chosen, **common)
            else:
                found = exhaustive(item.depths, airborne.renders, ground.matcher, consensus, **common)
        except DegenerateGeometry as error:
            found = refused(item.name, item.component, str(error)).registration
        return OneAnswer(found)

    weights = stamps(files_of(ground.matcher, options.retriever if few else None))
    return job.store.stage(
        f"{item.name}.tiles",
        compute,
        options=(ground.method, ground.matcher, options, consensus, weights, job.seed),
        after=[f"{base.name}.obliques", f"{base.name}.register", f"{item.name}.depths"],
        code=[skymoor.ground.tiles, skymoor.match, "skymoor.registration", skymoor.geometry],
    )


def _consensus(item: Placed, airborne: _Airborne, ground: GroundSetOptions) -> ConsensusOptions:
    """Options of the tile search for a component: its scales, and tiles of its photos' size, where metres are known."""
    options = _of_size(ground.cascade.consensus if ground.method == "cascade" else ground.exhaustive, item)
    placed = airborne.base.registration.enu_from_level
    if item.metric is None or placed is None or not airborne.renders:
        return options
    pixel_m = airborne.renders[0].view.pixel * placed.scale
    tile_px = tile_px_for(item.depths, item.metric.metres_per_unit, pixel_m)
    return replace(options, pictures=replace(options.pictures, tile_px=tile_px))


def _renders(base: Placed, job: Job) -> list[Render]:
    """The airborne model from above and from all sides."""
    options, model, nadir = job.options.render, base.model, base.render
    assert model is not None
    assert nadir is not None

    def compute() -> list[Render]:
        views = oblique_views(model.surface_points, model.pixel, options)
        return [nadir, *(model.render(view, progress=job.track(f"view {k + 1}")) for k, view in enumerate(views))]

    return job.store.stage(
        f"{base.name}.obliques",
        compute,
        options=options,
        after=[f"{base.name}.model", f"{base.name}.nadir"],
        code=[skymoor.model],
    )


def _heard(item: Placed, found: Registration | None, airborne: _Airborne | None, job: Job) -> Placed:
    """A component with its place, with what each of its cameras says of that, and with a picture."""
    if found is None or airborne is None:
        return item
    options, walls, enu_from_level = job.options.ground.place, airborne.walls, found.enu_from_level
    if not found.registered or enu_from_level is None or walls is None:
        return replace(item, registration=found)

    def compute() -> tuple[list[CameraWitness], Image | None]:
        measured, size = {m.camera.image for m in item.depths}, job.options.ground.densify.max_px
        others = [c for c in item.component.cameras if c.image not in measured]
        maps = [*item.depths, *(blind_map(camera, job.photos, size) for camera in others)]
        heard = hear_cameras(maps, walls, enu_from_level, options, rng=np.random.default_rng(job.seed))
        return heard, walls_picture(item.depths, walls, enu_from_level, options)

    witnesses, picture = job.store.stage(
        f"{item.name}.cameras",
        compute,
        options=(options, job.seed, enu_from_level.scale, enu_from_level.rotation, enu_from_level.translation),
        after=["walls", f"{item.name}.depths"],
        code=[skymoor.ground.walls, skymoor.ground, skymoor.match, skymoor.geometry],
    )
    return replace(item, registration=found, walls=picture, witnesses=tuple(witnesses))
