# SPDX-License-Identifier: Apache-2.0
"""The method on one page of plain calls (paper, section 3).

Every call of `store.stage` keeps its result, so that the same command again goes on where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skymoor.densify import DepthEstimator, check_camera_poses, relative_depths
from skymoor.errors import DegenerateGeometry
from skymoor.match.propose import ALL_AZIMUTHS
from skymoor.model import SceneModel, render_nadir
from skymoor.orient import GroundLabeler, estimate_gravity, ground_points, level_from_gravity
from skymoor.pipeline.job import ComponentResult, Job, Searched, or_else, refused
from skymoor.pipeline.photo_sets import or_too_few
from skymoor.pipeline.place_render import hypothesis_on_map, register_render, search_render
from skymoor.pipeline.register_best import Prior
from skymoor.pipeline.search import Extent, search_again
from skymoor.reconstruct import ReconstructOptions, reconstruct, with_focal
from skymoor.registration import focal_posterior
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.store import Kept
from skymoor.types import Component, DepthMap, Mask, Registration, Render

IMMATERIAL = 0.25
"""Standard deviations below which a correction of the focal length is left out: they grow by 3 %, a run is saved."""


def register_airborne(job: Job) -> list[ComponentResult]:
    """Every component of a set of airborne photos, registered or refused."""
    choices = job.options.reconstruct.stage_options(job.options.engines, shared_camera=True)
    # Photos from above do not determine intrinsics one by one, so none would be left; their lenses are told apart by
    # the scale of what they show, without being asked.
    choices = replace(choices, mixed_lenses=False)
    components = reconstruct_set("reconstruct", job, choices)
    return [_register_or_refuse(f"{job.name}-{k}", component, job) for k, component in enumerate(components)]


def _register_or_refuse(name: str, component: Component, job: Job) -> ComponentResult:
    return or_else(
        lambda: register_component(name, component, job), lambda reason: refused(name, component, reason), name
    )


def reconstruct_set(stage: str, job: Job, options: ReconstructOptions) -> list[Component]:
    """The components of a set of photos."""
    progress = job.track(f"{job.name}: reconstruction")
    return job.store.stage(stage, reconstruct, job.photos, options, seed=job.seed, progress=progress)


def ground_of(name: str, component: Component, labeler: GroundLabeler | None, job: Job) -> Mask | None:
    """Which points of a component are ground by their looks; None without a network that labels them."""
    if labeler is None:
        return None
    progress = job.track(f"{name}: ground labels")
    return job.store.stage(f"{name}.ground", ground_points, component, job.photos, labeler, progress=progress)


def register_component(name: str, component: Component, job: Job) -> ComponentResult:
    """Register one component; once more where the reference's relief corrects its focal length.

    Photos and relief are combined in one posterior of the focal length. A correction within a part of its own standard
    deviation is left alone and counts as an error.
    """
    first = _register(name, component, job)
    heights, calibration = first.registration.heights, component.calibration
    posterior = None if heights is None else focal_posterior(heights, calibration)
    if not first.registration.registered or posterior is None or calibration is None:
        return first
    ratio, sigma = posterior
    if abs(np.log(ratio)) < IMMATERIAL * sigma:
        return replace(first, component=replace(first.component, calibration=calibration.narrowed(ratio, sigma)))
    refocused = job.store.stage(f"{name}.refocus", with_focal, component, ratio, sigma)
    second = _register(f"{name}-refocused", refocused, job, first)
    return second if second.registration.registered else first


def _register(name: str, component: Component, job: Job, before: ComponentResult | None = None) -> ComponentResult:
    """Register a component, or refuse it; where it was `before`, with another focal length, from the same places."""
    job.end_of("reconstruct")
    options, store = job.options, job.store
    try:
        ground = ground_of(name, component, options.engines.labeler(options.orient.labels), job)
        gravity = estimate_gravity(component, rng=np.random.default_rng(job.seed), ground=ground)
        level_from_sfm = level_from_gravity(component, gravity)
        level = component.transformed(level_from_sfm)
        depths = densify_component(name, level, job, options.engines.stereo(options.densify.method))
        checks = store.stage(f"{name}.pose_checks", check_camera_poses, level.cameras, depths, job.photos)
        doubted = {check.image for check in checks if check.contradicts}
        depths = depths.take(k for k, one in enumerate(depths) if one.camera.image not in doubted)
        model = _model(name, level, depths, job)
        render = store.stage(f"{name}.nadir", render_nadir, model, options.render, progress=job.track("nadir view"))
    except DegenerateGeometry as error:
        return refused(name, component, or_too_few(str(error), len(component.cameras)))
    searched = _search(name, level, render, job) if before is None else _search_again(name, level, render, before, job)
    job.end_of("search")
    if not searched.hypotheses:
        none = Registration(registered=False, reason="", enu_from_level=None)
        nothing = with_criteria(none, [criterion("map_hypotheses", 0, 1)])
        return ComponentResult(name, level, level_from_sfm, nothing, gravity, depths, model, render)
    prior = Prior(gravity.sigma_deg, component.calibration)
    registration, matches = register_render(name, searched, render, prior, options.match.min_height_confidence, job)
    found = ComponentResult(name, level, level_from_sfm, registration, gravity, depths, model, render, matches)
    on_map = [hypothesis_on_map(hypothesis, render, job.reference) for hypothesis in searched.hypotheses]
    return replace(found, pose_checks=checks, hypotheses=on_map, searched=searched)


def densify_component(name: str, level: Component, job: Job, estimator: DepthEstimator) -> Kept[DepthMap]:
    """Depth maps of a levelled component, on the disk. Raises `DegenerateGeometry` without any."""
    progress = job.track(f"{name}: dense depth")
    depths = job.store.parts(f"{name}.depths", estimator, level, job.photos, progress=progress)
    if not depths:
        raise DegenerateGeometry("no photo has a partner to measure depth with")
    job.end_of("depth")
    return depths


def _model(name: str, level: Component, depths: Sequence[DepthMap], job: Job) -> SceneModel:
    options, engines, stage = job.options.model, job.options.engines, f"{name}.model"
    own = {"progress": job.track("model"), "checkpoint": job.store.scratch(stage)}
    ranking = engines.relative_depth(options.ranking) if options.kind == "nerf" else None
    if ranking is None:
        return job.store.stage(stage, options.builder(engines), level, depths, **own)
    progress = job.track(f"{name}: depths of single photos")
    monocular = job.store.stage(f"{name}.monocular", relative_depths, depths, ranking, progress=progress)
    return job.store.stage(stage, options.builder(engines), level, depths, monocular=monocular, **own)


def _search(name: str, level: Component, render: Render, job: Job) -> Searched:
    """At the flying heights and azimuths in question."""
    match = job.options.match
    azimuths = ALL_AZIMUTHS if job.heading is None else job.heading.azimuths(level.cameras)
    extent = Extent((match.min_height_m, match.max_height_m), azimuths)
    return search_render(name, render, extent, match.min_height_confidence, job)


def _search_again(name: str, level: Component, render: Render, before: ComponentResult, job: Job) -> Searched:
    """The same hypotheses after a correction of the focal length; what chance reaches does not change with it."""
    assert before.searched is not None and before.render is not None
    known = {camera.image: camera.centre[:2] for camera in before.component.cameras}
    centres = np.array([known[camera.image] for camera in level.cameras])
    moved = np.array([camera.centre[:2] for camera in level.cameras])
    settings = (job.reference, job.options.match.min_height_confidence, job.options.match.search)
    pairs = ((before.render, centres), (render, moved))
    found = job.store.stage(f"{name}.search", search_again, before.searched.hypotheses, *pairs, *settings)
    return Searched(found, before.searched.decoys)
