# SPDX-License-Identifier: Apache-2.0
"""Acceptance criteria of airborne registrations: a wrong registration that is accepted is worse than none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skymoor.registration.airborne import RegisterOptions
from skymoor.registration.criteria import ESTIMATE, criterion, with_criteria
from skymoor.registration.significance import false_alarm_probability
from skymoor.types import Criterion, Registration


def decide(
    registration: Registration,
    scores: Sequence[float],
    n_matches_2d: int,
    options: RegisterOptions | None = None,
    *,
    decoys: Sequence[float] = (),
    heights: float | None = None,
) -> Registration:
    """The registration with all criteria that were checked, accepted or refused with the first that failed.

    Args:
        registration: as estimated from the matches.
        scores: of the distinct hypotheses after refinement, this one first. Right ones scored 86 to 244 on the real and
            simulated sets that we measured; wrong ones at most 32 in a reference of another site, and 65 besides the
            right one in a square kilometre.
        n_matches_2d: matches before lifting.
        options: thresholds.
        decoys: null scores, see `decoy_scores`; without them `min_score` is the only limit on the score alone.
        heights: correlation of heights at the hypothesis, see `height_agreement`; None where it cannot be estimated.
    """
    options = options or RegisterOptions()
    best, second = scores[0], max(scores[1:], default=0.0)
    diagnostics = {
        **registration.diagnostics,
        "search_score": best,
        "second_score": second,
        "n_matches_2d": float(n_matches_2d),
    }
    criteria = [criterion("match_score", best, options.min_score)]
    if decoys:
        probability = false_alarm_probability(best, decoys)
        diagnostics |= {"decoy_score": float(max(decoys)), "false_alarm_probability": probability}
        criteria.append(criterion("false_alarm", probability, options.max_false_alarm))
    if heights is not None:
        diagnostics["height_agreement"] = heights
    criteria += [
        criterion("competing_score", best, options.min_score_margin * second),
        criterion(ESTIMATE, registration.registered, 1),
    ]
    if registration.registered:
        criteria += _of_matches(registration, options, heights)
    return with_criteria(replace(registration, diagnostics=diagnostics), criteria)


def _of_matches(registration: Registration, options: RegisterOptions, heights: float | None) -> list[Criterion]:
    """Criteria of an estimated transform."""
    criteria = [
        criterion("inliers", registration.n_inliers, options.min_inliers),
        criterion("inlier_ratio", registration.inlier_ratio, options.min_inlier_ratio),
    ]
    if heights is not None:
        criteria.append(criterion("height_correlation", heights, options.min_height_correlation))
    return [
        *criteria,
        criterion("cells", registration.diagnostics.get("cells", 0.0), options.min_cells),
        criterion("tilt", registration.tilt_deg, options.max_tilt_deg),
    ]
