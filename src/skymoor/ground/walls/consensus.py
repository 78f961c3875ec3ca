# SPDX-License-Identifier: Apache-2.0
"""From refined hypotheses to the registration of a ground model, accepted or refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr  # scipy.stats takes a second to load

from skymoor.geometry import Similarity
from skymoor.ground.plan_view import ScoreOptions
from skymoor.ground.walls.pool import WallHypothesis, apart
from skymoor.ground.walls.shared_error import with_shared_error
from skymoor.registration.criteria import ESTIMATE, criterion, with_criteria
from skymoor.types import Array, Criterion, Registration

SCORE_SPREAD, CONTRAST_SPREAD, PLAN_SPREAD = 0.25, 2.0, 2.0
"""Usual spread of the logarithm of the score, of the contrast and of the score in plan, over wrong hypotheses."""
CONTRAST_WEIGHT, PLAN_WEIGHT = 0.35, 0.58
"""Of the order of hypotheses before their photos are matched: a conditional logit (McFadden 1974) of right and wrong
ones on simulated sites, in which the score itself had no weight."""
PLAN_LIKELIHOOD, CELLS_LIKELIHOOD, CONTRAST_LIKELIHOOD = 0.42, 1.24, 0.1
"""Logarithm of the likelihood ratio of right to wrong placements, per unit of the score in plan, of ln(1 + cells) and
of the contrast: Fisher's linear discriminant on sites simulated under real conditions. Contrast had no weight there
beside the others; it has this one since it tells right from wrong where facades are seen well."""
KEY_POINTS_WEIGHT = 1.24
"""Of ln(1 + cells with key points that agree) in the order of hypotheses: as of the other matches, not fitted."""
NULL_MEAN, NULL_SPREAD, NULL_COUNT = 7.65, 1.4, 20
"""Of that sum over the best answers for mirrored components, the highest of all decoys; see docs/benchmarks.md. The
count is that of components, some of which answered with and without key points."""
UNAMBIGUOUS_SHARE = 0.25
"""Of wrong answers: the ones that also have the contrast and the lead over other places that are needed (7 of 30 before
all shifts were searched, 1 of 29 since, 5 of 20 mirrored ones with key points)."""
USUAL_HEIGHT_M, HEIGHT_SPREAD = ScoreOptions.usual_height_m, ScoreOptions.height_sigma
LEAST_HEIGHT_M, LARGEST_LOG = 0.3, 20.0
"""Of cameras above the ground, log-normal: held by people, on dashboards (2 to 3.5 m with the vehicle) and on poles."""


def agreement_in_both(score: ArrayLike, plan_score: ArrayLike) -> Array:
    """Agreement in elevation and in plan, where it is known, in units of their usual spread."""
    return np.asarray(np.log(np.maximum(score, 1.0)) / SCORE_SPREAD + _positive(plan_score) / PLAN_SPREAD)


def unusual_height(height_m: ArrayLike) -> Array:
    """What heights of the cameras above the ground take off agreement: minus the logarithm of their prior."""
    logs = np.log(np.maximum(height_m, LEAST_HEIGHT_M) / USUAL_HEIGHT_M) / HEIGHT_SPREAD
    return np.nan_to_num(logs**2 / 2)


def _positive(score: ArrayLike) -> Array:
    """What is unknown in plan, or contradicts there, is no evidence for a place."""
    return np.nan_to_num(np.maximum(score, 0.0))


@dataclass(frozen=True, eq=False)
class RefinedHypothesis:
    """A hypothesis after refinement, with its agreement with the photos.

    `score` and `ncc` are the agreement of all photos with `walls_seen` walls of the airborne model; `height_m` is the
    height of the cameras above the ground (median), `blocked` the share of viewing rays that cross
    walls; `cells` counts the independent cubes that hold inliers, see `independent_cells`; `perturbed_scores` are those
    of positions a few metres away. `plan_score` is the agreement in plan, see `PlanHypothesis`; NaN where unknown.
    `key_point_cells` counts places on walls with key points that agree, see `agreeing_cells`; None where none are
    matched.
    """

    origin: WallHypothesis
    registration: Registration
    enu_from_level: Similarity
    score: float
    ncc: float
    walls_seen: int
    height_m: float
    blocked: float
    cells: int
    perturbed_scores: tuple[float, ...] = ()
    plan_score: float = float("nan")
    key_point_cells: int | None = None

    @property
    def evidence(self) -> float:
        """What orders hypotheses before their photos are matched.

        Key points order places and do not decide about them: on facades that are alike from both sides they agree with
        a mirror image as well (docs/decisions/0031).
        """
        in_plan = float(_positive(self.plan_score))
        of_key_points = KEY_POINTS_WEIGHT * float(np.log1p(self.key_point_cells or 0))
        of_pictures = CONTRAST_WEIGHT * self.contrast + PLAN_WEIGHT * in_plan + of_key_points
        return of_pictures - float(unusual_height(self.height_m))

    @property
    def fit(self) -> float:
        """What chooses hypotheses to refine, and between those of one place: agreement on walls and in plan, and its
        contrast where that is known.
        """
        agreement = float(agreement_in_both(self.score, self.plan_score) - unusual_height(self.height_m))
        return agreement + self.contrast / CONTRAST_SPREAD

    @property
    def odds(self) -> float:
        """Logarithm of the odds of a hypothesis among those of its component, but for a constant."""
        return self.evidence + self._of_matches

    @property
    def likelihood(self) -> float:
        """Logarithm of the likelihood ratio of a right to a wrong placement of any component, but for a constant.

        It rests mostly on what is independent of how walls look alike: agreement in plan, and the number of places in
        space where matches of the photos agree.
        """
        of_pictures = PLAN_LIKELIHOOD * float(_positive(self.plan_score)) + CONTRAST_LIKELIHOOD * self.contrast
        return of_pictures + self._of_matches

    @property
    def _of_matches(self) -> float:
        return CELLS_LIKELIHOOD * float(np.log1p(self.cells)) if self.registration.registered else 0.0

    @property
    def contrast(self) -> float:
        """Excess of the score over those of perturbed positions, over the root of their spread.

        Walls resemble each other in floors and edges, so that two models agree a little wherever walls coincide, the
        more the larger they are. What only the right position explains vanishes when the model is perturbed.
        """
        if len(self.perturbed_scores) < 2:
            return 0.0
        gain = self.score - float(np.mean(self.perturbed_scores))
        # Scores are in standard deviations of noise.
        spread = max(float(np.std(self.perturbed_scores)), 1.0)
        return max(gain, 0.0) / sqrt(spread)


@dataclass(frozen=True)
class AcceptanceOptions:
    """When the best hypothesis is accepted.

    Attributes:
        min_contrast: see `RefinedHypothesis`; below it the model may be a few metres aside or of another scale.
        max_chance: largest probability that a wrong placement of a component passes with so high a likelihood.
        min_ratio: least ratio of the odds to those of the best hypothesis elsewhere.
        apart_m: hypotheses are elsewhere if they put the model's probes at least this far, on average.
        min_inlier_ratio: of the dense matches (the paper's).
        min_cells, cell_m: cubes in space with inliers: neighbouring matches are correlated.
        max_tilt_deg: by which the registration may tilt the levelled model.
        min_height_m, max_height_m: of the cameras; see `RefinedHypothesis`.
        max_blocked: share of viewing rays that may cross walls.
    """

    min_contrast: float = 6.0
    max_chance: float = 0.01
    min_ratio: float = 10.0
    apart_m: float = 5.0
    min_inlier_ratio: float = 0.2
    min_cells: int = 10
    cell_m: float = 2.0
    max_tilt_deg: float = 6.0
    min_height_m: float = 0.5
    max_height_m: float = 8.0
    max_blocked: float = 0.2


def decide_ground(
    candidates: Sequence[RefinedHypothesis], probes: Array, options: AcceptanceOptions | None = None
) -> Registration:
    """The registration of the best candidate with all criteria that were checked, accepted or refused.

    Args:
        candidates: refined hypotheses, the best one first, some of them of the same position.
        probes: points (n, 3) of the model by which places and views are compared.
        options: thresholds.
    """
    options = options or AcceptanceOptions()
    found_any = criterion("wall_hypotheses", len(candidates), 1)
    if not candidates:
        return with_criteria(Registration(registered=False, reason="", enu_from_level=None), [found_any])
    # Cameras in the air or behind walls make neither the best hypothesis nor a competing one.
    matched = [c for c in candidates if c.registration.registered] or list(candidates)
    possible = [c for c in matched if _possible(c, options)] or matched
    possible = sorted(possible, key=lambda c: -c.odds)
    best, found = possible[0], possible[0].registration
    elsewhere = _elsewhere(possible, probes, options.apart_m)
    lead = best.odds - max((c.odds for c in elsewhere), default=-np.inf)
    ratio = float(np.exp(min(lead, LARGEST_LOG)))
    diagnostics = {
        **found.diagnostics,
        "contrast": best.contrast,
        "second_contrast": max((c.contrast for c in elsewhere), default=0.0),
        "likelihood": best.likelihood,
        "second_likelihood": max((c.likelihood for c in elsewhere), default=0.0),
        "plan_score": best.plan_score,
        "score": best.score,
        "second_score": max((c.score for c in elsewhere), default=0.0),
        "ncc": best.ncc,
        "walls_seen": float(best.walls_seen),
        "support": float(best.origin.support),
        "pooled_score": best.origin.score,
        "height_m": best.height_m,
        "blocked": best.blocked,
        "cells": float(best.cells),
    }
    if best.key_point_cells is not None:
        diagnostics["key_point_cells"] = float(best.key_point_cells)
    criteria = [found_any, *_criteria(best, ratio, options)]
    return with_criteria(replace(with_shared_error(found), diagnostics=diagnostics), criteria)


def _elsewhere(candidates: Sequence[RefinedHypothesis], probes: Array, apart_m: float) -> list[RefinedHypothesis]:
    """Those of other places than the first, each place once: neighbours share what makes them agree."""
    kept = [candidates[0]]
    for one in candidates[1:]:
        if all(apart(one.enu_from_level, other.enu_from_level, probes) >= apart_m for other in kept):
            kept.append(one)
    return kept[1:]


def _chance(best: RefinedHypothesis) -> float:
    """Probability that one more wrong placement has so high a likelihood, contrast and lead.

    Of the likelihood by Student's predictive distribution, independent of the others.
    """
    spread = NULL_SPREAD * sqrt(1 + 1 / NULL_COUNT)
    return UNAMBIGUOUS_SHARE * float(stdtr(NULL_COUNT - 1, -(best.likelihood - NULL_MEAN) / spread))


def _criteria(best: RefinedHypothesis, ratio: float, options: AcceptanceOptions) -> list[Criterion]:
    found, of_matches = best.registration, []
    if found.registered:
        of_matches = [
            criterion("inlier_ratio", found.inlier_ratio, options.min_inlier_ratio),
            criterion("cells", best.cells, options.min_cells),
            criterion("tilt", found.tilt_deg, options.max_tilt_deg),
        ]
    return [
        criterion(ESTIMATE, found.registered, 1),
        criterion("chance_of_evidence", _chance(best), options.max_chance),
        criterion("likelihood_ratio", ratio, options.min_ratio),
        criterion("contrast", best.contrast, options.min_contrast),
        *of_matches,
        criterion("min_camera_height", best.height_m, options.min_height_m),
        criterion("max_camera_height", best.height_m, options.max_height_m),
        criterion("blocked", best.blocked, options.max_blocked),
    ]


def _possible(candidate: RefinedHypothesis, options: AcceptanceOptions) -> bool:
    """Whether the cameras are at eye height and their viewing rays are free."""
    on_ground = options.min_height_m <= candidate.height_m <= options.max_height_m
    return on_ground and candidate.blocked <= options.max_blocked
