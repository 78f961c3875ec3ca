# SPDX-License-Identifier: Apache-2.0
"""The method on one page of plain calls (paper, section 3).

Every call is a stage: `store` keeps its result, so that the same command again goes on where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
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
from skymoor.densify import SgmDepth
from skymoor.errors import DegenerateGeometry
from skymoor.geometry.similarity import Similarity
from skymoor.lift import LiftOptions, lift
from skymoor.match import CyclicOptions, Placement, SearchOptions, StructuralMatcher, match_placed, search_placements
from skymoor.match.align import lay
from skymoor.model import MeshBuilder
from skymoor.orient import OrientOptions, estimate_gravity, level_from_gravity
from skymoor.reconstruct import ReconstructOptions, reconstruct, with_focal
from skymoor.register import (
    RegisterOptions,
    Relief,
    ReliefOptions,
    compare_relief,
    focal_correction,
    judge,
    register,
)
from skymoor.render import RenderOptions, nadir_view
from skymoor.store import Store
from skymoor.types import (
    Array,
    Array32,
    Camera,
    Component,
    Gravity,
    Matches3D,
    Photos,
    Progress,
    Raster,
    Reference,
    Registration,
    Render,
)

Tracker = Callable[[str], Progress]
"""Gives the progress callback of a stage, by its name."""


@dataclass(frozen=True)
class MatchOptions:
    """From the nadir render to pixels of the reference.

    Attributes:
        min_height_m, max_height_m: flying heights that are searched: the scale of a levelled model.
        candidates: placements that are matched densely; the one with most independent inliers is believed.
    """

    min_height_m: float = 20.0
    max_height_m: float = 200.0
    candidates: int = 3
    min_height_confidence: float = 0.2
    search: SearchOptions = field(default_factory=SearchOptions)
    dense: StructuralMatcher = field(default_factory=StructuralMatcher)
    cyclic: CyclicOptions = field(default_factory=CyclicOptions)


@dataclass(frozen=True)
class Options:
    """Every option of every stage, by its dotted name."""

    reconstruct: ReconstructOptions = field(default_factory=ReconstructOptions)
    orient: OrientOptions = field(default_factory=OrientOptions)
    densify: SgmDepth = field(default_factory=SgmDepth)
    model: MeshBuilder = field(default_factory=MeshBuilder)
    render: RenderOptions = field(default_factory=RenderOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    lift: LiftOptions = field(default_factory=LiftOptions)
    register: RegisterOptions = field(default_factory=RegisterOptions)
    relief: ReliefOptions = field(default_factory=ReliefOptions)


@dataclass(frozen=True, eq=False)
class Placed:
    """A component and all that was found out about its place. `component` is in the `level` frame."""

    component: Component
    level_from_sfm: Similarity
    registration: Registration
    gravity: Gravity | None = None
    render: Render | None = None
    matches: Matches3D | None = None
    relief: Relief | None = None

    @property
    def cameras_enu(self) -> list[Camera]:
        """Cameras on Earth; empty where the component is not registered."""
        found = self.registration
        if not found.registered or found.enu_from_level is None:
            return []
        return [camera.moved(found.enu_from_level) for camera in self.component.cameras]


def register_airborne(
    photos: Photos, reference: Reference, options: Options, store: Store, *, seed: int, track: Tracker
) -> list[Placed]:
    """Every component of a set of airborne photos, placed on Earth or refused.

    The stages "photos" and "reference" must have run in `store`.
    """
    components = store.stage(
        "reconstruct",
        lambda: reconstruct(photos, options.reconstruct, seed=seed, progress=track("structure from motion")),
        options=(options.reconstruct, seed),
        after=["photos"],
        code=[skymoor.reconstruct, "skymoor.colmap"],
    )
    return [
        register_component(f"airborne-{k}", component, photos, reference, options, store, seed=seed, track=track)
        for k, component in enumerate(components)
    ]


def register_component(
    name: str,
    component: Component,
    photos: Photos,
    reference: Reference,
    options: Options,
    store: Store,
    *,
    seed: int,
    track: Tracker,
) -> Placed:
    """Place one component; once more where the reference's relief corrects its focal length."""

    def attempt(attempt_name: str, tried: Component) -> Placed:
        try:
            return _place(attempt_name, tried, photos, reference, options, store, seed=seed, track=track)
        except DegenerateGeometry as error:
            refused = Registration(registered=False, reason=str(error), enu_from_level=None)
            return Placed(tried, Similarity.identity(), refused)

    first = attempt(name, component)
    correction = focal_correction(first.relief, component.calibration, options.relief)
    if not first.registration.registered or correction is None:
        return first
    second = attempt(f"{name}-refocused", with_focal(component, *correction))
    return second if second.registration.registered else first


def _place(
    name: str,
    component: Component,
    photos: Photos,
    reference: Reference,
    options: Options,
    store: Store,
    *,
    seed: int,
    track: Tracker,
) -> Placed:
    rng = np.random.default_rng(seed)
    gravity = estimate_gravity(component, options.orient, rng=rng)
    level_from_sfm = level_from_gravity(component, gravity)
    level = component.moved(level_from_sfm)
    refocused = component.calibration.relief_ratio if component.calibration else None

    depths = store.stage(
        f"{name}.depths",
        lambda: options.densify(level, photos, progress=track("dense depth")),
        options=(options.densify, options.orient, seed, refocused),
        after=["photos", "reconstruct"],
        code=[skymoor.densify, skymoor.orient, skymoor.geometry],
    )
    if not depths:
        raise DegenerateGeometry("no photo has a partner to measure depth with")

    def render_nadir() -> Render:
        model = options.model(level, depths, progress=track("mesh"))
        view = nadir_view(model.surface_points, model.pixel, options.render)
        return model.render(view, progress=track("nadir view"))

    render = store.stage(
        f"{name}.nadir",
        render_nadir,
        options=(options.model, options.render),
        after=[f"{name}.depths"],
        code=[skymoor.model, skymoor.render],
    )
    picture, map_picture = nadir_raster(render, options.match), reference_raster(reference)
    px_per_metre = render.view.pixel / reference.grid.pixel_m
    placements = store.stage(
        f"{name}.search",
        lambda: search_placements(
            picture,
            map_picture,
            min_scale=options.match.min_height_m * px_per_metre,
            max_scale=options.match.max_height_m * px_per_metre,
            options=options.match.search,
            progress=track("search"),
        ),
        options=(options.match.search, options.match.min_height_m, options.match.max_height_m),
        after=["reference", f"{name}.nadir"],
        code=[skymoor.match],
    )
    if not placements:
        reason = "the reference is too small for the model at any height that was searched"
        refused = Registration(registered=False, reason=reason, enu_from_level=None)
        return Placed(level, level_from_sfm, refused, gravity, render)

    registration, matches = store.stage(
        f"{name}.register",
        lambda: _register_best(placements, render, picture, map_picture, reference, options, rng),
        options=(options.match, options.lift, options.register, seed),
        after=["reference", f"{name}.search"],
        code=[skymoor.match, skymoor.lift, skymoor.register, skymoor.geometry],
    )
    relief = None
    if registration.registered:
        _, up = lay_on_reference(render, registration, reference, options.match)
        relief = compare_relief(up, reference.height, reference.grid.pixel_m, options.relief)
    return Placed(level, level_from_sfm, registration, gravity, render, matches, relief)


def _register_best(
    placements: Sequence[Placement],
    render: Render,
    picture: Raster,
    map_picture: Raster,
    reference: Reference,
    options: Options,
    rng: np.random.Generator,
) -> tuple[Registration, Matches3D]:
    """Match densely at the best placements, and believe the one that most independent places confirm."""
    results: list[tuple[Registration, Matches3D]] = []
    for k, placement in enumerate(placements[: options.match.candidates]):
        b_from_a = placement.matrix(picture.mask.shape)
        metres_per_level = placement.scale * reference.grid.pixel_m / render.view.pixel
        matches_2d, _ = match_placed(picture, map_picture, b_from_a, options.match.dense, options.match.cyclic, rng=rng)
        matches = lift(matches_2d, render, reference, metres_per_level, options.lift)
        registration = register(matches, reference.grid.pixel_m, options.register, rng=rng)
        scores = [placement.score, *(other.score for j, other in enumerate(placements) if j != k)]
        results.append((judge(registration, scores, len(matches_2d), options.register), matches))
    return max(results, key=lambda result: (result[0].registered, result[0].diagnostics.get("cells", 0.0)))


def nadir_raster(render: Render, options: MatchOptions) -> Raster:
    """The render as a matcher takes it: heights only where they are believed."""
    heights = render.xyz[..., 2] / np.float32(render.view.pixel)
    believed = render.confidence >= options.min_height_confidence
    return Raster(render.rgb, np.isfinite(heights), np.where(believed, heights, np.nan).astype(np.float32))


def reference_raster(reference: Reference) -> Raster:
    """The reference as a matcher takes it."""
    return Raster(reference.rgb, reference.mask, (reference.height / reference.grid.pixel_m).astype(np.float32))


def lay_on_reference(
    render: Render, registration: Registration, reference: Reference, options: MatchOptions
) -> tuple[Raster, Array32]:
    """The registered nadir render on the reference's grid, and its believed heights, ENU up in metres."""
    if registration.enu_from_level is None:
        raise DegenerateGeometry("the model is not registered")
    b_from_a = reference_from_render(render, registration, reference)
    # `lay` keeps heights in pixels: give it metres in pixels of the render, and it returns them in the grid's.
    metres_per_px = registration.enu_from_level.scale * render.view.pixel
    up = registration.enu_from_level.apply(render.xyz.astype(np.float64))[..., 2] / metres_per_px
    picture = nadir_raster(render, options)
    known = picture.height is not None and np.isfinite(picture.height)
    picture = Raster(picture.rgb, picture.mask, np.where(known, up, np.nan).astype(np.float32))
    height, width = reference.grid.shape
    laid = lay(picture, b_from_a, (width, height))
    assert laid.height is not None
    return laid, np.asarray(laid.height * np.float32(reference.grid.pixel_m), dtype=np.float32)


def reference_from_render(render: Render, registration: Registration, reference: Reference) -> Array:
    """(2, 3) affine from the render's pixels to the reference's, at ground level."""
    if registration.enu_from_level is None:
        raise DegenerateGeometry("the model is not registered")
    corners = np.array([[0.0, 0.0], [render.view.shape[1], 0.0], [0.0, render.view.shape[0]]])
    view = np.column_stack([[render.view.x0, render.view.y0] + corners * render.view.pixel, np.zeros(3)])
    level = view @ render.view.view_from_level
    placed = reference.grid.px_from_enu(registration.enu_from_level.apply(level)[:, :2])
    return np.asarray(cv2.getAffineTransform(corners.astype(np.float32), placed.astype(np.float32)))
