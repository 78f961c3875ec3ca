# SPDX-License-Identifier: Apache-2.0
"""The method on one page of plain calls (paper, section 3).

Every call is a stage: `store` keeps its result, so that the same command again goes on where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

import skymoor.densify
import skymoor.geometry
import skymoor.lift
import skymoor.match
import skymoor.model
import skymoor.orient
import skymoor.reconstruct
import skymoor.register
import skymoor.render
from skymoor.choice import files_of
from skymoor.densify import DepthEstimator, MetricScale
from skymoor.errors import DegenerateGeometry
from skymoor.geometry.similarity import Similarity
from skymoor.ground import CameraWitness
from skymoor.lift import lift
from skymoor.match import Placement, match_placed, search_placements
from skymoor.model import SceneModel
from skymoor.orient import LabelOptions, estimate_gravity, ground_points, level_from_gravity
from skymoor.overlay import lay_on_reference, nadir_raster, reference_raster
from skymoor.reconstruct import ReconstructOptions, reconstruct, with_focal
from skymoor.register import Relief, compare_relief, focal_correction, judge, register
from skymoor.render import nadir_view
from skymoor.settings import Options
from skymoor.store import Store
from skymoor.types import (
    Array,
    Array32,
    Camera,
    Component,
    DepthMap,
    Gravity,
    Image,
    Mask,
    Matches3D,
    Photos,
    Progress,
    Reference,
    Registration,
    Render,
)
from skymoor.weights import stamps


@dataclass(frozen=True, eq=False)
class Job:
    """What one set of photos is placed with. The stages `photos_stage` and "reference" must have run in `store`.

    `track` gives the progress callback of a stage, by its name.
    """

    photos: Photos
    reference: Reference
    options: Options
    store: Store
    seed: int
    track: Callable[[str], Progress]
    name: str = "airborne"
    photos_stage: str = "photos"


@dataclass(frozen=True, eq=False)
class Placed:
    """A component and all that was found out about its place. `component` is in the `level` frame.

    `name` is that of its stages. A ground component stands on `base`, an airborne one; `walls` shows both, and each of
    its photos may have said whether it agrees (`witnesses`). `metric` is its size as single photos say it.
    """

    name: str
    component: Component
    level_from_sfm: Similarity
    registration: Registration
    gravity: Gravity | None = None
    depths: Sequence[DepthMap] = ()
    model: SceneModel | None = None
    render: Render | None = None
    matches: Matches3D | None = None
    relief: Relief | None = None
    base: Placed | None = None
    walls: Image | None = None
    witnesses: Sequence[CameraWitness] = ()
    metric: MetricScale | None = None

    @property
    def cameras_enu(self) -> list[Camera]:
        """Cameras on Earth; empty where the component is not registered, and without those that contradict it."""
        found = self.registration
        if not found.registered or found.enu_from_level is None:
            return []
        return [self.component.cameras[k].moved(found.enu_from_level) for k in self._trusted]

    @property
    def shape_enu(self) -> Array | None:
        """Covariances (n, 3, 3) m^2 of the centres of `cameras_enu` by the reconstruction alone; None if not known."""
        placed = self.registration.enu_from_level
        if placed is None or self.component.centre_covariances is None:
            return None
        turn = placed.scale * placed.rotation
        return np.asarray(turn @ self.component.centre_covariances[self._trusted] @ turn.T)

    @property
    def _trusted(self) -> list[int]:
        doubted = {witness.image for witness in self.witnesses if witness.contradicts}
        return [k for k, camera in enumerate(self.component.cameras) if camera.image not in doubted]


def register_airborne(job: Job) -> list[Placed]:
    """Every component of a set of airborne photos, placed on Earth or refused."""
    components = reconstruct_set("reconstruct", job, job.options.reconstruct)
    return [register_component(f"{job.name}-{k}", component, job) for k, component in enumerate(components)]


def reconstruct_set(stage: str, job: Job, options: ReconstructOptions) -> list[Component]:
    """The components of a set of photos."""
    return job.store.stage(
        stage,
        lambda: reconstruct(job.photos, options, seed=job.seed, progress=job.track(f"{job.name}: reconstruction")),
        options=(options, job.seed, stamps(options.ready())),
        after=[job.photos_stage],
        code=[skymoor.reconstruct, "skymoor.colmap", "skymoor.aliked", skymoor.match],
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


def refused(name: str, component: Component, reason: str) -> Placed:
    """A component that has no place, with the reason."""
    nothing = Registration(registered=False, reason=reason, enu_from_level=None)
    return Placed(name, component, Similarity.identity(), nothing)


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
        code=[skymoor.reconstruct, "skymoor.colmap"],
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
        model = _model(name, level, depths, job)
        render = _render_nadir(name, model, job)
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    placements = _search(name, render, job)
    if not placements:
        reason = "the reference is too small for the model at any height that was searched"
        nothing = Registration(registered=False, reason=reason, enu_from_level=None)
        return Placed(name, level, level_from_sfm, nothing, gravity, depths, model, render)
    registration, matches = job.store.stage(
        f"{name}.register",
        lambda: _register_best(placements, render, job),
        options=(options.match, stamps(options.match.dense.ready()), options.lift, options.register, job.seed),
        after=["reference", f"{name}.search"],
        code=[skymoor.match, skymoor.lift, skymoor.register, skymoor.geometry],
    )
    relief = None
    if registration.registered:
        _, up = lay_on_reference(render, registration, reference, options.match.min_height_confidence)
        relief = compare_relief(up, reference.height, reference.grid.pixel_m, options.relief)
    return Placed(name, level, level_from_sfm, registration, gravity, depths, model, render, matches, relief)


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


def _model(name: str, level: Component, depths: Sequence[DepthMap], job: Job) -> SceneModel:
    options, builder = job.options.model, job.options.model.builder
    after = [f"{name}.depths"]
    if options.ranking is not None:
        builder = partial(options.nerf, monocular=_single_photo_depths(name, depths, job))
        after.append(f"{name}.monocular")
    return job.store.stage(
        f"{name}.model",
        lambda: builder(level, depths, progress=job.track("model"), checkpoint=job.store.scratch(f"{name}.model")),
        options=options.builder,
        after=after,
        code=[skymoor.model, "skymoor.raycast"],
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
        after=[f"{name}.depths"],
        code=[skymoor.densify],
    )


def _render_nadir(name: str, model: SceneModel, job: Job) -> Render:
    options = job.options.render
    return job.store.stage(
        f"{name}.nadir",
        lambda: model.render(nadir_view(model.surface_points, model.pixel, options), progress=job.track("nadir view")),
        options=options,
        after=[f"{name}.model"],
        code=[skymoor.render],
    )


def _search(name: str, render: Render, job: Job) -> list[Placement]:
    match = job.options.match
    px_per_metre = render.view.pixel / job.reference.grid.pixel_m
    return job.store.stage(
        f"{name}.search",
        lambda: search_placements(
            nadir_raster(render, match.min_height_confidence),
            reference_raster(job.reference),
            min_scale=match.min_height_m * px_per_metre,
            max_scale=match.max_height_m * px_per_metre,
            options=match.search,
            progress=job.track("search"),
        ),
        options=(match.search, match.min_height_m, match.max_height_m, match.min_height_confidence),
        after=["reference", f"{name}.nadir"],
        code=[skymoor.match, "skymoor.overlay"],
    )


def _register_best(placements: Sequence[Placement], render: Render, job: Job) -> tuple[Registration, Matches3D]:
    """Match densely at the best placements, and believe the one that most independent places confirm."""
    options, reference, rng = job.options, job.reference, np.random.default_rng(job.seed)
    picture, map_picture = nadir_raster(render, options.match.min_height_confidence), reference_raster(reference)
    dense, cyclic = options.match.dense.engine, options.match.cyclic
    results: list[tuple[Registration, Matches3D]] = []
    for k, placement in enumerate(placements[: options.match.candidates]):
        b_from_a = placement.matrix(picture.mask.shape)
        metres_per_level = placement.scale * reference.grid.pixel_m / render.view.pixel
        matches_2d, _ = match_placed(picture, map_picture, b_from_a, dense, cyclic, rng=rng)
        matches = lift(matches_2d, render, reference, metres_per_level, options.lift)
        registration = register(matches, reference.grid.pixel_m, options.register, rng=rng)
        scores = [placement.score, *(other.score for j, other in enumerate(placements) if j != k)]
        results.append((judge(registration, scores, len(matches_2d), options.register), matches))
    return max(results, key=lambda result: (result[0].registered, result[0].diagnostics.get("cells", 0.0)))
