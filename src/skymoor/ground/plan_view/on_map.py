# SPDX-License-Identifier: Apache-2.0
"""Ground components straight on a map, without airborne photos: by their plan on its height steps and orthophoto."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skymoor.engines.options import FIXED
from skymoor.geo import Grid
from skymoor.geometry import Similarity
from skymoor.ground.plan_view.ground_colour import colour_map
from skymoor.ground.plan_view.posterior import PlanPosterior, plan_posterior
from skymoor.ground.plan_view.score import PlanScores
from skymoor.ground.plan_view.search import PlanSearchOptions, search_plan
from skymoor.ground.plan_view.target import PlanTarget, plan_target
from skymoor.ground.plan_view.template import plan_model
from skymoor.registration import ground_level
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.registration.detail import averaged
from skymoor.types import Array, Array32, DepthMap, HeightVerdict, Progress, Reference, Registration, no_progress

TILT_SIGMA_DEG = 1.0  # of a levelled component
DSM_SIGMA_M = 0.5  # of the ground under cameras, beside the reference's own accuracy
LIKELIEST = 3  # places of which one may be accepted, if others contradict other components
FEWEST_OTHERS, MOST_OTHERS = 6, 13  # places that tell the distribution of the highest scores: lower ones do not
WITHOUT_HEIGHTS = HeightVerdict("NOT_CONFIRMED", "the reference has no heights here")
ON_GROUND = HeightVerdict(
    "OFFSET_ONLY", "cameras stand on the reference's ground; their own relief is too small to confirm it"
)


@dataclass(frozen=True)
class OnMapOptions:
    """Registration of ground components straight on the reference, where there are no airborne photos.

    Attributes:
        max_chance: largest probability that the best of many wrong places leads the next one so far.
        apart_m: cameras are at another place if they are at least this far away, on average.
        cell_m: of the search in plan.
        compared: places from which the distribution of scores at wrong ones is estimated.
        plan: of the search.
    """

    max_chance: float = 0.01
    apart_m: float = 5.0
    cell_m: float = field(default=0.75, metadata=FIXED)
    compared: int = field(default=16, metadata=FIXED)
    plan: PlanSearchOptions = field(default_factory=lambda: PlanSearchOptions(min_scale=0.5), metadata=FIXED)


@dataclass(frozen=True, eq=False)
class MapTarget:
    """A reference in plan, and the heights (h, w) of its ground in metres up, NaN where unknown, on the same grid."""

    plan: PlanTarget
    ground: Array32

    def ground_at(self, xy: Array) -> Array:
        """Heights (n,) of the ground at plan positions (n, 2); NaN where unknown."""
        u, v = np.floor(self.plan.grid.px_from_enu(xy)).astype(np.int64).T
        rows, columns = self.ground.shape
        inside = (u >= 0) & (v >= 0) & (u < columns) & (v < rows)
        return np.asarray(np.where(inside, self.ground[np.where(inside, v, 0), np.where(inside, u, 0)], np.nan))


def map_target(reference: Reference, cell_m: float = OnMapOptions.cell_m) -> MapTarget:
    """Height steps, houses and colours of a reference; colours alone where it has no relief."""
    step = max(1, round(cell_m / reference.grid.pixel_m))
    up = averaged(reference.height, step)
    rgb = np.where(reference.mask[..., None], reference.rgb, np.nan).astype(np.float32)
    rgb = np.dstack([averaged(np.ascontiguousarray(rgb[..., k]), step) for k in range(3)])
    shown = np.isfinite(rgb[..., 0])
    grid = Grid(reference.grid.east0, reference.grid.north0, step * reference.grid.pixel_m, up.shape)
    colour = colour_map(np.nan_to_num(rgb), shown)
    if reference.has_relief:
        return MapTarget(plan_target(up, grid, colour=colour), ground_level(up, grid.pixel_m))
    flat = np.zeros(up.shape, np.float32)
    return MapTarget(PlanTarget(grid, np.stack([flat, flat]), flat, shown, colour), up)


@dataclass(frozen=True, eq=False)
class OnMapHypotheses:
    """The likeliest places of a component on a map, see `Hypotheses`.

    `registrations` are of the first of all its places, whose `place_scores` are in the same order.
    """

    registrations: tuple[Registration, ...]
    place_scores: tuple[float, ...]
    max_chance: float

    @property
    def similarities(self) -> list[Similarity]:
        """ENU from level, of the likeliest places."""
        return [one.enu_from_level for one in self.registrations if one.enu_from_level is not None]

    @property
    def scores(self) -> list[float]:
        """Scores of these."""
        return list(self.place_scores[: len(self.registrations)])

    def decide(self, excluded: Collection[int] = ()) -> Registration:
        """The registration at the best place that is not in `excluded` (their numbers), accepted or refused."""
        left = [k for k in range(len(self.registrations)) if k not in excluded]
        found_any = criterion("map_places", len(left), 1)
        if not left:
            return with_criteria(Registration(registered=False, reason="", enu_from_level=None), [found_any])
        score = self.place_scores[left[0]]
        others = [other for k, other in enumerate(self.place_scores) if k not in excluded and k != left[0]]
        diagnostics = {"plan_score": score, "second_plan_score": max(others, default=float("nan"))}
        found = replace(self.registrations[left[0]], diagnostics={**diagnostics, "places": float(len(others) + 1)})
        chance = criterion("chance_of_lead", chance_of_lead(score, others), self.max_chance)
        return with_criteria(found, [found_any, chance])


def chance_of_lead(best: float, others: Sequence[float]) -> float:
    """Probability that the best place of a component leads all others so far though it is a wrong one.

    The highest of many scores at wrong places have exponentially distributed spacings, of a mean that does not depend
    on how many there are (Weissman, Journal of the American Statistical Association 1978), and so not on the area: of
    the spacing after the j-th highest it is proportional to 1 / j. The ratio of the first spacing to that mean,
    estimated from the k next ones, has an F distribution.
    """
    ranked = np.sort(np.asarray(others, dtype=np.float64))[::-1]
    ranked = ranked[np.isfinite(ranked)][:MOST_OTHERS]
    if len(ranked) < FEWEST_OTHERS:
        return 1.0
    k, lead = len(ranked) - 1, best - float(ranked[0])
    # The highest of the others is the second of all.
    mean = max(float((np.arange(2, k + 2) * -np.diff(ranked)).mean()), 1e-6)
    return 1.0 if lead <= 0 else float((1 + lead / (k * mean)) ** -k)


def search_on_map(
    maps_level: Sequence[DepthMap],
    target: MapTarget,
    options: OnMapOptions | None = None,
    *,
    min_scale: float,
    max_scale: float,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> OnMapHypotheses:
    """Places of a levelled ground component on a map.

    Args:
        maps_level: depth maps of its photos, z up, the ground at 0; the unit is the cameras' height above the ground.
        target: of `map_target`.
        options: see there.
        min_scale, max_scale: metres per unit that are searched.
        rng: for the plan of the component.
        progress: counts scales.

    Raises `DegenerateGeometry` where no depth map holds a steep surface.
    """
    options = options or OnMapOptions()
    limits = replace(options.plan, min_scale=min_scale, max_scale=max_scale)
    limits = replace(limits, keep=options.compared, apart_m=options.apart_m)
    model = plan_model(maps_level, rng=rng)
    scores = PlanScores(model, target.plan, limits.score)
    found = search_plan(model, target.plan, limits, progress=progress)
    likeliest = (plan_posterior(scores, one.enu_from_level) for one in found[:LIKELIEST])
    registrations = tuple(_registration(one, target, model.cameras) for one in likeliest if one is not None)
    return OnMapHypotheses(registrations, tuple(one.score for one in found), options.max_chance)


def _registration(found: PlanPosterior, target: MapTarget, cameras: Array) -> Registration:
    """The similarity raised so that the plane z = 0 is the ground under the cameras (n, 3), with its covariance."""
    flat = found.enu_from_level
    ground = target.ground_at(flat.apply(cameras)[:, :2])
    known = bool(np.isfinite(ground).any())
    up = float(np.nanmedian(ground)) if known else 0.0
    raised = Similarity(1.0, np.eye(3), np.array([0.0, 0.0, up - flat.translation[2]])) @ flat
    covariance = np.zeros((7, 7))
    plan, tilt = [0, 3, 4, 5], np.radians(TILT_SIGMA_DEG) ** 2
    covariance[np.ix_(plan, plan)] = found.covariance
    covariance[1, 1] = covariance[2, 2] = tilt
    # The cameras are one unit above the ground: its length is their height.
    height = flat.scale * float(np.median(cameras[:, 2]))
    covariance[6, 6] = DSM_SIGMA_M**2
    covariance[[0, 3, 4, 5], 6] = covariance[6, [0, 3, 4, 5]] = height * found.covariance[0]
    covariance[6, 6] += height**2 * found.covariance[0, 0]
    return Registration(
        registered=True,
        reason="",
        enu_from_level=raised,
        tilt_deg=0.0,
        covariance=covariance,
        centroid_enu=raised.apply(cameras.mean(axis=0)[None])[0],
        heights=ON_GROUND if known else WITHOUT_HEIGHTS,
    )
