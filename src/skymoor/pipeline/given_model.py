# SPDX-License-Identifier: Apache-2.0
"""Registration of a model that somebody has made: by its photos, or by its own surface from above."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.errors import DegenerateGeometry, InputError
from skymoor.geometry import Similarity
from skymoor.match.propose import ALL_AZIMUTHS
from skymoor.models.given import GivenModel, Plan
from skymoor.models.render import SAMPLE, level_of, mirrored, render_given
from skymoor.orient import estimate_gravity, level_from_gravity
from skymoor.pipeline.airborne import register_component
from skymoor.pipeline.job import ComponentResult, Job, or_else, refused
from skymoor.pipeline.place_render import hypothesis_on_map, register_render, search_render
from skymoor.pipeline.register_best import Prior
from skymoor.pipeline.search import Extent
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.types import Component, Gravity, HeightVerdict, Registration, Render

CLAIM_RATIO = 1.5
"""Ratio to either side of the scale that a model claims, within which it is searched first."""
SMALLEST_M, LARGEST_M = 25.0, 2000.0
"""Sides of models that are searched where nothing is known of their scale."""
SIGNIFICANT = 3.0
"""Standard deviations."""
NO_HEIGHTS = 2.0
"""Confidence that no height has: none is compared."""
FLAT = HeightVerdict("NOT_CONFIRMED", "the model is an orthophoto without heights")
MIRRORED = (
    "the model is mirrored (left-handed): its mirror image was found on the map; negate one axis of it, or export it "
    "again without swapping two"
)


@dataclass(frozen=True, eq=False)
class Levelled:
    """A model with z up: the transform, what its component is there, and the error of up in degrees.

    `up_is_found` says that nothing but the shape of the surface tells up from down.
    """

    level_from_model: Similarity
    component: Component
    tilt_sigma_deg: float
    gravity: Gravity | None = None
    up_is_found: bool = False

    def upside_down(self, component: Component) -> Levelled:
        """With z down for up; `component` is that of the model."""
        turned = Similarity(1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ self.level_from_model
        return Levelled(turned, component.transformed(turned), self.tilt_sigma_deg)


def register_given(model: GivenModel, job: Job) -> ComponentResult:
    """Register a given model, or refuse it.

    Raises `InputError` where not the model but its mirror image is on the map.
    """
    name, component = f"{job.name}-0", _component_of(model)
    if model.photos is not None and model.component is not None and model.sparse:
        photos, cameras = model.photos, model.component
        action = lambda: register_component(name, cameras, replace(job, photos=photos))  # noqa: E731
    else:
        action = lambda: _register_surface(name, model, component, job)  # noqa: E731
    return or_else(action, lambda reason: refused(name, component, reason), name)


def _component_of(model: GivenModel) -> Component:
    """Its cameras, or a component without any that has points of the surface."""
    if model.component is not None:
        return model.component
    points, colours = np.zeros((0, 3)), None
    if isinstance(model.surface, Plan):
        plan = model.surface
        v, u = np.nonzero(plan.mask)
        chosen = slice(None, None, max(1, len(u) // SAMPLE))
        u, v = u[chosen], v[chosen]
        xy = np.column_stack([u + 0.5, v + 0.5, np.ones(len(u))]) @ plan.model_from_px.T
        z = np.zeros(len(u)) if plan.heights is None else np.nan_to_num(plan.heights[v, u], nan=0.0)
        points, colours = np.column_stack([xy, z]), plan.rgb[v, u]
    else:
        chosen = slice(None, None, max(1, len(model.surface.points) // SAMPLE))
        points = model.surface.points[chosen]
        colours = None if model.surface.colours is None else model.surface.colours[chosen]
    none = np.zeros(0, np.int32)
    black = np.zeros((len(points), 3), np.uint8)
    return Component((), points, black if colours is None else colours, none, none, np.zeros((0, 2)), float("nan"))


def _register_surface(name: str, model: GivenModel, component: Component, job: Job) -> ComponentResult:
    try:
        levelled = _levelled(model, component, job.seed)
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    found, searched_m = _at_all_scales(name, model, levelled, job)
    if found.registration.registered:
        return _unless_inverted(found, levelled, model)
    assert found.render is not None
    as_mirrored = _register_render(f"{name}-mirrored", mirrored(found.render), levelled, searched_m, model, job)
    if not as_mirrored.registration.registered:
        return found
    # Seen from below, a model looks mirrored.
    if levelled.up_is_found:
        other, _ = _at_all_scales(f"{name}-upside-down", model, levelled.upside_down(component), job)
        if other.registration.registered:
            return _unless_inverted(other, levelled, model)
    raise InputError(f"{model.parts[0].path}: {MIRRORED}")


def _at_all_scales(
    name: str, model: GivenModel, levelled: Levelled, job: Job
) -> tuple[ComponentResult, tuple[float, float]]:
    """Registered at the first scales that allow it, else as refused at the last ones; and these."""
    turn, progress = levelled.level_from_model, job.track("nadir view")
    render = job.store.stage(f"{name}.nadir", render_given, model.surface, turn, job.options.render)
    progress(1, 1)
    scales = _scales(model, levelled, render, job)
    for attempt, heights_m in enumerate(scales):
        stage = name if attempt == 0 else f"{name}-any-scale"
        found = _register_render(stage, render, levelled, heights_m, model, job)
        if found.registration.registered:
            break
    return found, heights_m


def _unless_inverted(found: ComponentResult, levelled: Levelled, model: GivenModel) -> ComponentResult:
    """The result, unless up was found and the model is hollow where the map is raised: then it is mirrored."""
    verdict = found.registration.heights
    if (
        levelled.up_is_found
        and verdict is not None
        and (verdict.scale or 0.0) < -SIGNIFICANT * (verdict.scale_sigma or 0.0)
    ):
        raise InputError(f"{model.parts[0].path}: {MIRRORED}")
    return found


def _levelled(model: GivenModel, component: Component, seed: int) -> Levelled:
    """By cameras and points where there are cameras, else by the surface."""
    rng = np.random.default_rng(seed)
    if model.component is not None and model.up is None:
        gravity = estimate_gravity(component, rng=rng)
        turn = level_from_gravity(component, gravity)
        return Levelled(turn, component.transformed(turn), gravity.sigma_deg, gravity)
    turn, sigma = level_of(model.surface, model.up, rng)
    stated = model.up is not None or isinstance(model.surface, Plan)
    return Levelled(turn, component.transformed(turn), sigma, up_is_found=not stated)


def _scales(model: GivenModel, levelled: Levelled, render: Render, job: Job) -> list[tuple[float, float]]:
    """Least and largest metres per level unit: first near the scale that the model claims, then all in question."""
    match, grid = job.options.match, job.reference.grid
    claimed = None if model.unit_m is None else model.unit_m / levelled.level_from_model.scale
    first = [] if claimed is None else [(claimed / CLAIM_RATIO, claimed * CLAIM_RATIO)]
    if levelled.gravity is not None:
        return [*first, (match.min_height_m, match.max_height_m)]
    side = render.view.pixel * float(np.sqrt(np.isfinite(render.xyz[..., 2]).sum()))
    largest = min(LARGEST_M, max(grid.shape) * grid.pixel_m)
    return [*first, (SMALLEST_M / side, max(largest, SMALLEST_M) / side)]


def _register_render(
    name: str, render: Render, levelled: Levelled, heights_m: tuple[float, float], model: GivenModel, job: Job
) -> ComponentResult:
    match = job.options.match
    flat = isinstance(model.surface, Plan) and model.surface.heights is None
    min_confidence = NO_HEIGHTS if flat else match.min_height_confidence
    result = ComponentResult(
        name,
        levelled.component,
        levelled.level_from_model,
        Registration(registered=False, reason="", enu_from_level=None),
        levelled.gravity,
        render=render,
        flat=flat,
    )
    searched = search_render(name, render, Extent(heights_m, ALL_AZIMUTHS), min_confidence, job)
    if not searched.hypotheses:
        return replace(result, registration=with_criteria(result.registration, [criterion("map_hypotheses", 0, 1)]))
    prior = Prior(levelled.tilt_sigma_deg, None)
    registration, matches = register_render(name, searched, render, prior, min_confidence, job)
    if flat and registration.registered:
        registration = replace(registration, heights=FLAT)
    on_map = [hypothesis_on_map(one, render, job.reference) for one in searched.hypotheses]
    return replace(result, registration=registration, matches=matches, hypotheses=on_map, searched=searched)
