# SPDX-License-Identifier: Apache-2.0
"""Search of a ground component on the airborne walls: hypotheses, their refinement, and their scores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions
from skymoor.ground.walls.component import ComponentSearch, view_probes
from skymoor.ground.walls.consensus import RefinedHypothesis
from skymoor.ground.walls.hypotheses import WallHypotheses
from skymoor.ground.walls.pool import apart, pool_hypotheses
from skymoor.types import DepthMap, Progress, no_progress

SAME_POSE_M = 1.0  # mean distance of cameras and views


def search_ground(
    maps_level: Sequence[DepthMap],
    airborne: AirborneWalls,
    options: GroundOptions | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> WallHypotheses:
    """Hypotheses of a levelled ground component, refined, best first (the offline way of paper section 3.4).

    Args:
        maps_level: depth maps of its photos, z up; its unit is between `min_scale` and `max_scale` metres.
        airborne: of `airborne_walls`.
        options: see there.
        rng: for walls and consensus; the same state gives the same result.
        progress: counts the walls that are searched, then the hypotheses that are refined.

    Returns:
        the hypotheses. The diagnostics of the registration that is decided from them are "likelihood" and
        "second_likelihood" of the best hypothesis and of the best one elsewhere, their "contrast", "second_contrast",
        "score" and "second_score", "plan_score", "ncc",
        "walls_seen", "support" (walls that agree), "pooled_score" of these, "key_point_cells" where key points are
        matched, "height_m", "blocked", "cells", and the
        extent of the search: "walls", "guesses" (hypotheses of single walls), "answers" (pooled ones).
    """
    options = options or GroundOptions()
    # Sizes of walls are options in metres: the middle of the scales makes them approximately metric.
    metric_from_level = Similarity(float(np.sqrt(options.min_scale * options.max_scale)), np.eye(3), np.zeros(3))
    search = ComponentSearch.of(maps_level, metric_from_level, airborne, options, rng)
    single = search.wall_hypotheses(progress)
    pooled = pool_hypotheses(single, search.probes, options.pool)
    scored = [*(search.refined_by_walls(hypothesis) for hypothesis in pooled), *search.plan_hypotheses(progress)]
    scored = _distinct([search.shifted(hypothesis) for hypothesis in scored], search)
    scored = [search.with_key_points(hypothesis) for hypothesis in scored]
    refined = _refined(_finalists(scored, options.finalists), search, progress)
    counts = {"walls": len(search.searched), "guesses": len(single), "answers": len(pooled), "scored": len(scored)}
    return WallHypotheses(
        tuple(refined), view_probes(maps_level), {name: float(n) for name, n in counts.items()}, options.acceptance
    )


def _distinct(scored: Sequence[RefinedHypothesis], search: ComponentSearch) -> list[RefinedHypothesis]:
    """Of hypotheses that came to the same pose, the one that fits best."""
    probes, kept = view_probes(search.maps), list[RefinedHypothesis]()
    for one in sorted(scored, key=lambda hypothesis: -hypothesis.fit):
        if all(apart(one.enu_from_level, other.enu_from_level, probes) >= SAME_POSE_M for other in kept):
            kept.append(one)
    return kept


def _finalists(scored: Sequence[RefinedHypothesis], count: int) -> list[RefinedHypothesis]:
    """Those that fit best, the best in plan, where steps of the search matter less, and in key points, in turn."""
    by_fit = sorted(scored, key=lambda hypothesis: -hypothesis.fit)
    in_plan = sorted(scored, key=lambda hypothesis: -np.nan_to_num(hypothesis.plan_score, nan=-np.inf))
    by_key_points = sorted(by_fit, key=lambda hypothesis: -(hypothesis.key_point_cells or 0))
    in_turn = [one for each in zip(by_fit, in_plan, by_key_points, strict=True) for one in each]
    return list({id(one): one for one in in_turn}.values())[:count]


def _best_of_places(
    ranked: Sequence[RefinedHypothesis], count: int, search: ComponentSearch
) -> list[RefinedHypothesis]:
    """Of each of the first places, which differ in cameras or views, the hypothesis that fits best.

    Beside the right one there are others, a little larger or a bay aside, that are nearly as good in plan.
    """
    probes, apart_m = view_probes(search.maps), search.options.acceptance.apart_m
    places: list[list[RefinedHypothesis]] = []
    for one in ranked:
        near = (place for place in places if apart(one.enu_from_level, place[0].enu_from_level, probes) < apart_m)
        place = next(near, None)
        if place is None:
            places.append([one])
        else:
            place.append(one)
    return [max(place, key=lambda hypothesis: hypothesis.fit) for place in places[:count]]


def _refined(
    hypotheses: Sequence[RefinedHypothesis], search: ComponentSearch, progress: Progress
) -> list[RefinedHypothesis]:
    """The hypotheses refined with all photos, best first; the best of them by matches, on walls of their own scale."""
    moved = []
    for done, hypothesis in enumerate(hypotheses):
        moved.append(search.refined_as_a_whole(hypothesis, search.options.screen))
        moved[-1] = search.with_key_points(search.with_background(moved[-1]))
        progress(done + 1, len(hypotheses))
    ranked = sorted(moved, key=lambda hypothesis: -hypothesis.evidence)
    matched = _best_of_places(ranked, search.options.matched, search)
    rescaled: dict[int, ComponentSearch] = {}
    found = []
    for hypothesis in ranked:
        if not any(hypothesis is one for one in matched):
            found.append(search.in_level_frame(hypothesis))
            continue
        # Scales this near find the same walls.
        step = round(np.log(hypothesis.enu_from_level.scale) / np.log(1.1))
        if step and step not in rescaled:
            rescaled[step] = search.rescaled(1.1**step)
        own = rescaled[step] if step else search
        current = own.refined_by_photos(own.taken_from(search, hypothesis))
        current = own.with_background(own.refined_as_a_whole(current, own.options.refine))
        found.append(own.in_level_frame(own.with_key_points(own.fitted_to_matches(current))))
    return sorted(found, key=lambda hypothesis: -hypothesis.odds)
