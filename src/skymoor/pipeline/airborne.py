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
from skymoor.match import ImageHypothesis
from skymoor.model import SceneModel, render_nadir
from skymoor.orient import GroundLabeler, estimate_gravity, ground_points, level_from_gravity
from skymoor.pipeline.job import ComponentResult, Job, MapHypothesis, or_else, refused
from skymoor.pipeline.null_samples import null_samples
from skymoor.pipeline.register_best import Prior, register_best
from skymoor.pipeline.search import search_reference
from skymoor.reconstruct import ReconstructOptions, reconstruct, with_focal
from skymoor.registration import focal_posterior, inlier_limit_m
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.types import Component, DepthMap, Mask, Matches3D, Reference, Registration, Render

DECISIVE = 1 / 10
"""Share of the largest false-alarm probability below which further decoys could not change the verdict."""
IMMATERIAL = 0.25
"""Standard deviations below which a correction of the focal length is left out: they grow by 3 %, a run is saved."""


def register_airborne(job: Job) -> list[ComponentResult]:
    """Every component of a set of airborne photos, registered or refused."""
    choices = job.options.reconstruct.stage_options(job.options.engines, shared_camera=True)
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
    second = _register(f"{name}-refocused", refocused, job)
    return second if second.registration.registered else first


def _register(name: str, component: Component, job: Job) -> ComponentResult:
    options, store = job.options, job.store
    try:
        ground = ground_of(name, component, options.engines.labeler(options.orient.labels), job)
        gravity = estimate_gravity(component, rng=np.random.default_rng(job.seed), ground=ground)
        level_from_sfm = level_from_gravity(component, gravity)
        level = component.transformed(level_from_sfm)
        depths = densify_component(name, level, job, options.engines.stereo(options.densify.method))
        checks = store.stage(f"{name}.pose_checks", check_camera_poses, level.cameras, depths, job.photos)
        doubted = {check.image for check in checks if check.contradicts}
        depths = [depth_map for depth_map in depths if depth_map.camera.image not in doubted]
        model = _model(name, level, depths, job)
        render = store.stage(f"{name}.nadir", render_nadir, model, options.render, progress=job.track("nadir view"))
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    hypotheses = _search(name, render, job)
    if not hypotheses:
        none = Registration(registered=False, reason="", enu_from_level=None)
        nothing = with_criteria(none, [criterion("map_hypotheses", 0, 1)])
        return ComponentResult(name, level, level_from_sfm, nothing, gravity, depths, model, render)
    prior = Prior(gravity.sigma_deg, component.calibration)
    registration, matches = _consensus(name, hypotheses, render, prior, job)
    found = ComponentResult(name, level, level_from_sfm, registration, gravity, depths, model, render, matches)
    on_map = [_on_map(hypothesis, render, job.reference) for hypothesis in hypotheses]
    return replace(found, pose_checks=checks, hypotheses=on_map)


def densify_component(name: str, level: Component, job: Job, estimator: DepthEstimator) -> list[DepthMap]:
    """Depth maps of a levelled component. Raises `DegenerateGeometry` without any."""
    progress = job.track(f"{name}: dense depth")
    depths = job.store.stage(f"{name}.depths", estimator, level, job.photos, progress=progress)
    if not depths:
        raise DegenerateGeometry("no photo has a partner to measure depth with")
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


def _search(name: str, render: Render, job: Job) -> list[ImageHypothesis]:
    match, progress = job.options.match, job.track("search")
    heights_m = (match.min_height_m, match.max_height_m)
    settings = (heights_m, match.min_height_confidence, match.search)
    return job.store.stage(f"{name}.search", search_reference, render, job.reference, *settings, progress=progress)


def _consensus(
    name: str, hypotheses: Sequence[ImageHypothesis], render: Render, prior: Prior, job: Job
) -> tuple[Registration, Matches3D]:
    """The registration that most independent matches confirm, accepted or refused."""
    options, match = job.options, job.options.match
    matcher = options.engines.dense_matcher(match.matcher)
    decoys = job.store.stage(
        f"{name}.decoys",
        null_samples,
        hypotheses[0],
        render,
        job.reference,
        (match.min_height_m, match.max_height_m),
        match.min_height_confidence,
        match.search,
        match.decoys,
        matcher,
        match.cyclic,
        inlier_limit_m(job.reference.grid.pixel_m, options.register),
        options.register.correlation_m,
        decisive=options.register.max_false_alarm * DECISIVE,
        seed=job.seed,
        progress=job.track("decoys"),
    )
    return job.store.stage(
        f"{name}.register",
        register_best,
        hypotheses,
        decoys,
        render,
        job.reference,
        matcher,
        prior,
        candidates=match.candidates,
        min_confidence=match.min_height_confidence,
        cyclic=match.cyclic,
        lift_options=options.lift,
        options=options.register,
        seed=job.seed,
    )


def _on_map(hypothesis: ImageHypothesis, render: Render, reference: Reference) -> MapHypothesis:
    east, north = reference.grid.enu_from_px(np.array([hypothesis.centre_px]))[0].tolist()
    metres_per_unit = hypothesis.scale * reference.grid.pixel_m / render.view.pixel
    azimuth_deg = float(np.degrees(hypothesis.azimuth_rad) % 360)
    return MapHypothesis(hypothesis.score, east, north, azimuth_deg, metres_per_unit)
