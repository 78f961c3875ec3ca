# SPDX-License-Identifier: Apache-2.0
"""The method on one page of plain calls (paper, section 3).

Every call is a stage: `store` keeps its result, so that the same command again goes on where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import skymoor.densify
import skymoor.geometry
import skymoor.match
import skymoor.model
import skymoor.orient
import skymoor.reconstruct
import skymoor.registration
from skymoor.densify import DepthEstimator, PhotoWitness, blind_map, hear_photos
from skymoor.engines.choice import files_of
from skymoor.engines.weights import stamps
from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.match import Placement, decoy_scores, match_placed, search_placements
from skymoor.model import SceneModel, nadir_view
from skymoor.orient import LabelOptions, estimate_gravity, ground_points, level_from_gravity
from skymoor.pipeline.job import Hypothesis, Job, Placed, or_else, refused
from skymoor.pipeline.overlay import lay_on_reference, nadir_raster, reference_raster
from skymoor.reconstruct import ReconstructOptions, reconstruct, with_focal
from skymoor.registration import (
    chance_probability,
    compare_relief,
    focal_correction,
    height_agreement,
    judge,
    lift,
    register,
)
from skymoor.types import Array32, Component, DepthMap, Mask, Matches3D, Raster, Reference, Registration, Render


def register_airborne(job: Job) -> list[Placed]:
    """Every component of a set of airborne photos, placed on Earth or refused."""
    components = reconstruct_set("reconstruct", job, job.options.reconstruct)
    return [_register_or_refuse(f"{job.name}-{k}", component, job) for k, component in enumerate(components)]


def _register_or_refuse(name: str, component: Component, job: Job) -> Placed:
    return or_else(
        lambda: register_component(name, component, job), lambda reason: refused(name, component, reason), name
    )


def reconstruct_set(stage: str, job: Job, options: ReconstructOptions) -> list[Component]:
    """The components of a set of photos."""
    return job.store.stage(
        stage,
        lambda: reconstruct(job.photos, options, seed=job.seed, progress=job.track(f"{job.name}: reconstruction")),
        options=(options, job.seed, stamps(options.ready())),
        after=[job.photos_stage],
        code=[skymoor.reconstruct, "skymoor.engines.colmap", "skymoor.engines.aliked", skymoor.match],
    )


def ground_of(name: str, component: Component, labels: LabelOptions, job: Job, source: str) -> Mask | None:
    """Which points of a component, that the stage `source` made, are ground by their looks; None without labels."""
    if labels.engine is None:
        return None
    return job.store.stage(
        f"{name}.ground",
        lambda: ground_points(component, job.photos, labels, progress=job.track(f"{name}: ground labels")),
        options=(labels.engine, stamps(labels.ready())),
        after=[job.photos_stage, source],
        code=[skymoor.orient],
    )


def register_component(name: str, component: Component, job: Job) -> Placed:
    """Place one component; once more where the reference's relief corrects its focal length."""
    first = _place(name, component, job, source="reconstruct")
    correction = focal_correction(first.relief, component.calibration, job.options.relief)
    if correction is None:
        return first
    refocused = job.store.stage(
        f"{name}.refocus",
        lambda: with_focal(component, *correction),
        options=correction,
        after=[f"{name}.register"],
        code=[skymoor.reconstruct, "skymoor.engines.colmap"],
    )
    second = _place(f"{name}-refocused", refocused, job, source=f"{name}.refocus")
    return second if second.registration.registered else first


def _place(name: str, component: Component, job: Job, *, source: str) -> Placed:
    """Place a component, which the stage `source` made."""
    options, reference = job.options, job.reference
    try:
        ground = ground_of(name, component, options.labels, job, source)
        gravity = estimate_gravity(component, options.orient, rng=np.random.default_rng(job.seed), ground=ground)
        level_from_sfm = level_from_gravity(component, gravity)
        level = component.moved(level_from_sfm)
        depths = densify_component(name, level, level_from_sfm, job, source, options.densify)
        witnesses = _heard(name, level, depths, job)
        doubted = {witness.image for witness in witnesses if witness.contradicts}
        depths = [depth_map for depth_map in depths if depth_map.camera.image not in doubted]
        model = _model(name, level, depths, job)
        render = _render_nadir(name, model, job)
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    placements = _search(name, render, job)
    if not placements:
        reason = "the reference is too small for the model at any height that was searched"
        nothing = Registration(registered=False, reason=reason, enu_from_level=None)
        return Placed(name, level, level_from_sfm, nothing, gravity, depths, model, render)
    decoys = _decoys(name, placements[0], render, job)
    registration, matches = job.store.stage(
        f"{name}.register",
        lambda: _register_best(placements, decoys, render, job),
        options=(options.match, stamps(options.match.dense.ready()), options.lift, options.register, job.seed),
        after=["reference", f"{name}.search", f"{name}.decoys"],
        code=[skymoor.match, skymoor.registration, "skymoor.registration", skymoor.geometry],
    )
    relief = None
    if registration.registered:
        _, up = lay_on_reference(render, registration, reference, options.match.min_height_confidence)
        relief = compare_relief(up, reference.height, reference.grid.pixel_m, options.relief)
    found = Placed(name, level, level_from_sfm, registration, gravity, depths, model, render, matches, relief)
    hypotheses = [_hypothesis(placement, render, reference) for placement in placements]
    return replace(found, witnesses=witnesses, hypotheses=hypotheses)


def _hypothesis(placement: Placement, render: Render, reference: Reference) -> Hypothesis:
    east, north = reference.grid.enu_from_px(np.array([placement.place]))[0].tolist()
    metres_per_unit = placement.scale * reference.grid.pixel_m / render.view.pixel
    return Hypothesis(placement.score, east, north, float(np.degrees(placement.heading_rad) % 360), metres_per_unit)


def densify_component(
    name: str, level: Component, level_from_sfm: Similarity, job: Job, source: str, estimator: DepthEstimator
) -> list[DepthMap]:
    """Depth maps of a component, which the stage `source` made and which was levelled since.

    Raises `DegenerateGeometry` without any.
    """
    depths = job.store.stage(
        f"{name}.depths",
        lambda: estimator(level, job.photos, progress=job.track(f"{name}: dense depth")),
        options=(estimator, level_from_sfm.scale, level_from_sfm.rotation, level_from_sfm.translation),
        after=[job.photos_stage, source],
        code=[skymoor.densify, skymoor.geometry],
    )
    if not depths:
        raise DegenerateGeometry("no photo has a partner to measure depth with")
    return depths


def _heard(name: str, level: Component, depths: Sequence[DepthMap], job: Job) -> list[PhotoWitness]:
    """What the photos say of each other's cameras."""
    options = job.options

    def compute() -> list[PhotoWitness]:
        measured = {depth_map.camera.image for depth_map in depths}
        others = [camera for camera in level.cameras if camera.image not in measured]
        blind = (blind_map(camera, job.photos, options.agreement.width_px) for camera in others)
        return hear_photos([*depths, *blind], options.agreement)

    return job.store.stage(
        f"{name}.witnesses",
        compute,
        options=options.agreement,
        after=[f"{name}.depths"],
        code=[skymoor.densify],
    )


def _model(name: str, level: Component, depths: Sequence[DepthMap], job: Job) -> SceneModel:
    options, builder = job.options.model, job.options.model.builder
    after = [f"{name}.depths", f"{name}.witnesses"]
    if options.ranking is not None:
        builder = partial(options.nerf, monocular=_single_photo_depths(name, depths, job))
        after.append(f"{name}.monocular")
    return job.store.stage(
        f"{name}.model",
        lambda: builder(level, depths, progress=job.track("model"), checkpoint=job.store.scratch(f"{name}.model")),
        options=options.builder,
        after=after,
        code=[skymoor.model, "skymoor.engines.raycast"],
    )


def _single_photo_depths(name: str, depths: Sequence[DepthMap], job: Job) -> list[Array32]:
    """Relative depths of the photos of depth maps."""
    engine = job.options.model.ranking
    assert engine is not None
    progress = job.track(f"{name}: depths of single photos")

    def compute() -> list[Array32]:
        found = []
        for depth_map in depths:
            found.append(engine(depth_map.rgb))
            progress(len(found), len(depths))
        return found

    return job.store.stage(
        f"{name}.monocular",
        compute,
        options=(engine, stamps(files_of(engine))),
        after=[f"{name}.depths", f"{name}.witnesses"],
        code=[skymoor.densify],
    )


def _render_nadir(name: str, model: SceneModel, job: Job) -> Render:
    options = job.options.render
    return job.store.stage(
        f"{name}.nadir",
        lambda: model.render(nadir_view(model.surface_points, model.pixel, options), progress=job.track("nadir view")),
        options=options,
        after=[f"{name}.model"],
        code=[skymoor.model],
    )


def _search(name: str, render: Render, job: Job) -> list[Placement]:
    match = job.options.match
    return job.store.stage(
        f"{name}.search",
        lambda: search_placements(
            *_pictures(render, job),
            **_scales(render, job),
            options=match.search,
            progress=job.track("search"),
        ),
        options=(match.search, match.min_height_m, match.max_height_m, match.min_height_confidence),
        after=["reference", f"{name}.nadir"],
        code=[skymoor.match, "skymoor.pipeline.overlay"],
    )


def _decoys(name: str, best: Placement, render: Render, job: Job) -> list[float]:
    """What pictures like the render, that lie nowhere, score in the reference."""
    match, sure = job.options.match, job.options.register.max_chance / 50
    return job.store.stage(
        f"{name}.decoys",
        lambda: decoy_scores(
            *_pictures(render, job),
            **_scales(render, job),
            options=match.search,
            decoys=match.decoys,
            rng=np.random.default_rng(job.seed),
            enough=lambda scores: chance_probability(best.score, scores) < sure,
            progress=job.track("decoys"),
        ),
        options=(match.decoys, sure, job.seed),
        after=[f"{name}.search"],
        code=[skymoor.match, "skymoor.registration.chance", "skymoor.pipeline.overlay"],
    )


def _pictures(render: Render, job: Job) -> tuple[Raster, Raster]:
    """Render and reference as matchers take them."""
    return nadir_raster(render, job.options.match.min_height_confidence), reference_raster(job.reference)


def _scales(render: Render, job: Job) -> dict[str, Any]:
    """Pixels of the reference per pixel of the render, for the flying heights that are searched."""
    match, px_per_metre = job.options.match, render.view.pixel / job.reference.grid.pixel_m
    return {"min_scale": match.min_height_m * px_per_metre, "max_scale": match.max_height_m * px_per_metre}


def _register_best(
    placements: Sequence[Placement], decoys: Sequence[float], render: Render, job: Job
) -> tuple[Registration, Matches3D]:
    """Match densely at the best placements, and believe the one that most independent places confirm."""
    options, reference, rng = job.options, job.reference, np.random.default_rng(job.seed)
    picture, map_picture = _pictures(render, job)
    dense, cyclic = options.match.dense.engine, options.match.cyclic
    results: list[tuple[Registration, Matches3D]] = []
    for k, placement in enumerate(placements[: options.match.candidates]):
        b_from_a = placement.matrix(picture.mask.shape)
        metres_per_level = placement.scale * reference.grid.pixel_m / render.view.pixel
        matches_2d, _ = match_placed(picture, map_picture, b_from_a, dense, cyclic, rng=rng)
        matches = lift(matches_2d, render, reference, metres_per_level, options.lift)
        registration = register(matches, reference.grid.pixel_m, options.register, rng=rng)
        heights = None
        if registration.registered:
            _, up = lay_on_reference(render, registration, reference, options.match.min_height_confidence)
            heights = height_agreement(up, reference.height, reference.grid.pixel_m)
        scores = [placement.score, *(other.score for j, other in enumerate(placements) if j != k)]
        found = judge(registration, scores, len(matches_2d), options.register, decoys=decoys, heights=heights)
        results.append((found, matches))
    return max(results, key=lambda result: (result[0].registered, result[0].diagnostics.get("cells", 0.0)))
