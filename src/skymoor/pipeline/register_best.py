# SPDX-License-Identifier: Apache-2.0
"""Dense matches at the best hypotheses of the search, and the registration with most independent inliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geo import Grid, sample
from skymoor.match.align import match_hypothesis
from skymoor.match.cyclic import CyclicOptions
from skymoor.match.hypothesis import ImageHypothesis
from skymoor.match.overlay import warp_to_grid
from skymoor.match.protocol import DenseMatcher
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.pipeline.search import Place
from skymoor.registration import (
    HeightFit,
    LiftOptions,
    NullSample,
    RegisterOptions,
    compare_heights,
    decide,
    fit_plan,
    flat_transform,
    ground_level,
    inlier_limit_m,
    is_bare_earth,
    judge_heights,
    lift,
    place_on_map,
    raised,
)
from skymoor.registration.agreement import Agreement, count_cells
from skymoor.registration.on_map import FINE_M
from skymoor.types import Array, Array32, Calibration, HeightVerdict, Matches3D, Raster, Reference, Registration, Render

BARE_SPREAD = 0.7
"""Ratio of what the fit of open ground leaves to that of everything, below which the rest is houses and trees."""
MIN_TILT_SIGMA_DEG = 0.3
"""Floor of the levelling's own figure, which is a formal one."""


@dataclass(frozen=True)
class Prior:
    """What the photos alone say of a model: how well it is levelled, and the focal lengths that they leave open."""

    tilt_sigma_deg: float
    calibration: Calibration | None


def register_best(
    hypotheses: Sequence[ImageHypothesis],
    places: Sequence[Place],
    decoys: Sequence[NullSample],
    render: Render,
    grid: Grid,
    matcher: DenseMatcher,
    prior: Prior,
    *,
    min_confidence: float,
    cyclic: CyclicOptions,
    lift_options: LiftOptions,
    options: RegisterOptions,
    seed: int,
) -> tuple[Registration, Matches3D]:
    """The registration of the best hypothesis, accepted or refused, and its matches.

    Args:
        hypotheses: hypotheses of the search, best first.
        places: of the first ones, those that are matched.
        decoys: null samples of the same search.
        render: what is matched, by `matcher`, with the references of the places.
        grid: of the reference that was searched; its pixels are those of the matches on return.
        prior: what the photos say.
        min_confidence: heights of the render below it are left out.
        cyclic, lift_options, options: of the steps.
        seed: of random choices.
    """
    rng = np.random.default_rng(seed)
    steps = Steps(matcher, cyclic, lift_options, options, min_confidence)
    image = nadir_raster(render, min_confidence)
    results: list[tuple[Registration, Matches3D]] = []
    for k, place in enumerate(places):
        images = image, reference_raster(place.reference)
        candidate = register_hypothesis(place.hypothesis, images, render, place.reference, prior, steps, rng=rng)
        scores = [place.hypothesis.score, *(other.score for j, other in enumerate(hypotheses) if j != k)]
        one, n = candidate.registration, candidate.n_matches_2d
        found = decide(
            one,
            scores,
            n,
            options,
            agreement=candidate.agreement,
            decoys=decoys,
        )
        results.append((found, _on_grid(candidate.matches, place.reference.grid, grid)))
    return max(results, key=lambda result: (result[0].registered, result[0].diagnostics.get("cells", 0.0)))


def _on_grid(matches: Matches3D, own: Grid, grid: Grid) -> Matches3D:
    """Matches in pixels of their own grid, with those of another."""
    if own == grid:
        return matches
    pixels = matches.pixels
    return replace(matches, pixels=replace(pixels, px_b=grid.px_from_enu(own.enu_from_px(pixels.px_b))))


@dataclass(frozen=True)
class Steps:
    """How a hypothesis is matched, lifted and registered."""

    matcher: DenseMatcher
    cyclic: CyclicOptions
    lift: LiftOptions
    register: RegisterOptions
    min_confidence: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis with its matches: the transform that they agree on, and in how many cells; not yet decided."""

    registration: Registration
    matches: Matches3D
    agreement: Agreement
    n_matches_2d: int


def register_hypothesis(
    hypothesis: ImageHypothesis,
    images: tuple[Raster, Raster],
    render: Render,
    reference: Reference,
    prior: Prior,
    steps: Steps,
    *,
    rng: np.random.Generator,
) -> Candidate:
    """Match the render densely at a hypothesis, lift the matches and register them; `images` are those of both."""
    image, map_image = images
    b_from_a = hypothesis.matrix(image.mask.shape)
    metres_per_level = hypothesis.scale * reference.grid.pixel_m / render.view.pixel
    matches_2d, _ = match_hypothesis(image, map_image, b_from_a, steps.matcher, steps.cyclic, rng=rng)
    matches = lift(matches_2d, render, reference, metres_per_level, steps.lift)
    above_m = _above_ground(matches, render, metres_per_level)
    found = register_on_map(matches, above_m, render, reference, prior, steps, rng=rng)
    inliers = np.zeros(len(matches), bool) if found.inliers is None else found.inliers
    cell_px = steps.register.correlation_m / reference.grid.pixel_m
    cells = count_cells(image.mask, map_image.mask, b_from_a, matches.pixels.px_b, inliers, cell_px)
    return Candidate(found, matches, cells, len(matches_2d))


def register_on_map(
    matches: Matches3D,
    above_ground_m: Array,
    render: Render,
    reference: Reference,
    prior: Prior,
    steps: Steps,
    *,
    rng: np.random.Generator,
) -> Registration:
    """The registration that most matches agree on in plan, with its heights judged; not yet accepted or refused.

    `above_ground_m` (n,) are heights of the matches above the model's ground; the other arguments are those of
    `register_hypothesis`.
    """
    plan, east_north = matches.xyz_level[:, :2], matches.xyz_enu[:, :2]
    limit = inlier_limit_m(reference.grid.pixel_m, steps.register)
    try:
        fit = fit_plan(plan, east_north, above_ground_m, inlier_m=limit, rng=rng)
        _, up = warp_to_grid(render, flat_transform(fit), reference.grid, steps.min_confidence)
        heights, verdict = _heights(up, reference, prior.calibration)
        tilt_deg = min(steps.register.tilt_sigma_deg, max(prior.tilt_sigma_deg, MIN_TILT_SIGMA_DEG))
        return place_on_map(matches, fit, heights, verdict, above_ground_m, tilt_sigma_deg=tilt_deg, rng=rng)
    except (TooFewMatches, DegenerateGeometry) as error:
        reason = f"no transform: {error}"
        return Registration(registered=False, reason=reason, enu_from_level=None, n_matches=len(matches))


def _heights(
    up: Array32, reference: Reference, calibration: Calibration | None
) -> tuple[HeightFit | None, HeightVerdict]:
    """The model's heights (h, w) against the reference's, on its grid; on open ground alone if it shows no more."""
    grid, surface = reference.grid, reference.height
    fit = compare_heights(up, surface, grid, reference.dsm_pixel_m)
    if fit is None or reference.dsm_pixel_m > FINE_M or not is_bare_earth(up, surface, grid.pixel_m):
        return fit, judge_heights(fit, calibration)
    # A coarse surface model that was interpolated has no houses either, but it does not fit open ground alone better.
    ground = compare_heights(up, surface, grid, reference.dsm_pixel_m, use=~raised(up, grid.pixel_m))
    bare = ground is not None and ground.spread_m < BARE_SPREAD * fit.spread_m
    return (ground, judge_heights(ground, calibration, bare=True)) if bare else (fit, judge_heights(fit, calibration))


def _above_ground(matches: Matches3D, render: Render, metres_per_level: float) -> Array:
    """Heights (n,) in metres of the matches above the model's ground, NaN where unknown."""
    up = render.xyz[..., 2] * np.float32(metres_per_level)
    ground = ground_level(up, render.view.pixel * metres_per_level)
    return np.asarray(sample(up - ground, matches.pixels.px_a))
