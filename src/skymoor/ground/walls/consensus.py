# SPDX-License-Identifier: Apache-2.0
"""From the hypotheses of single walls to the registration of a ground model, accepted or refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.plan_view import PlanSearchOptions
from skymoor.registration.criteria import ESTIMATE, criterion, with_criteria
from skymoor.registration.significance import predictive_tail
from skymoor.types import Array, Criterion, Registration

SCORE_SPREAD, CONTRAST_SPREAD, PLAN_SPREAD = 0.25, 2.0, 2.0
"""Usual spread of the logarithm of the score, of the contrast and of the score in plan, over wrong hypotheses."""
USUAL_HEIGHT_M, HEIGHT_SPREAD = PlanSearchOptions.usual_height_m, PlanSearchOptions.height_sigma
LEAST_HEIGHT_M = 0.3
"""Of cameras above the ground, log-normal: held by people, on dashboards (2 to 3.5 m with the vehicle) and on poles."""
EVIDENCE_SPREAD, USUAL_RIVALS = 2.0, 4
"""Usual spread of the evidence of wrong hypotheses of one component, and its weight beside the observed one."""


@dataclass(frozen=True, eq=False)
class WallHypothesis:
    """A similarity of the whole model that maps one of its walls onto one wall of the other model.

    `score` is the agreement of the orthophotos of the two walls, in standard deviations of noise; of a pooled
    hypothesis, that of all its `support` walls.
    """

    enu_from_level: Similarity
    wall: int
    other: int
    score: float
    support: int = 1


@dataclass(frozen=True)
class PoolOptions:
    """Pooling of hypotheses from single walls.

    Attributes:
        screened: hypotheses that are considered, best first.
        lead_ratio: hypotheses below this share of the best score can support others, and are not results themselves.
        near_m: two hypotheses agree if they map the probes of the model this close to each other on average.
        keep: hypotheses that are returned.
    """

    screened: int = 6000
    lead_ratio: float = 0.6
    near_m: float = 2.5
    keep: int = 20


def pool_hypotheses(
    hypotheses: Sequence[WallHypothesis], probes: Array, options: PoolOptions | None = None
) -> list[WallHypothesis]:
    """The hypotheses on which most walls agree, best first and distinct from each other.

    The pooled score is the root of the sum of squares, over the walls, of the best agreeing score of each: the walls
    are independent observations.

    Args:
        hypotheses: of all walls.
        probes: points (n, 3) of the model, its cameras and walls, by which distances of hypotheses are measured.
        options: see there.
    """
    options = options or PoolOptions()
    ranked = sorted(hypotheses, key=lambda one: -one.score)[: options.screened]
    if not ranked:
        return []
    probes_enu = np.array([one.enu_from_level.apply(probes) for one in ranked])
    walls, scores = np.array([one.wall for one in ranked]), np.array([one.score for one in ranked])
    pooled: list[WallHypothesis] = []
    for k in np.flatnonzero(scores > options.lead_ratio * scores[0]):
        near = np.linalg.norm(probes_enu - probes_enu[k], axis=2).mean(axis=1) < options.near_m
        best = [float(scores[near & (walls == wall)].max()) for wall in np.unique(walls[near])]
        pooled.append(replace(ranked[k], score=float(np.linalg.norm(best)), support=len(best)))
    kept: list[WallHypothesis] = []
    for one in sorted(pooled, key=lambda other: -other.score):
        if all(_apart(one.enu_from_level, q.enu_from_level, probes) >= 2 * options.near_m for q in kept):
            kept.append(one)
    return kept[: options.keep]


def agreement_in_both(score: float, plan_score: float) -> float:
    """Agreement in elevation and in plan, where it is known, in units of their usual spread."""
    in_plan = 0.0 if np.isnan(plan_score) else max(plan_score, 0.0)
    return float(np.log(max(score, 1.0))) / SCORE_SPREAD + in_plan / PLAN_SPREAD


@dataclass(frozen=True, eq=False)
class RefinedHypothesis:
    """A hypothesis after refinement, with its agreement with the photos.

    `score` and `ncc` are the agreement of all photos with `walls_seen` walls of the airborne model; `height_m` is the
    height of the cameras above the ground (median), `blocked` the share of viewing rays that cross
    walls; `cells` counts the independent cubes that hold inliers, see `independent_cells`; `perturbed_scores` are those
    of positions a few metres away. `plan_score` is the agreement in plan, see `PlanHypothesis`; NaN where unknown.
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

    @property
    def evidence(self) -> float:
        """Agreement in elevation, its contrast, and agreement in plan, in units of their usual spread; less what speaks
        against it, an unusual height of the cameras.

        Of the score the logarithm, whose spread over wrong hypotheses is alike at large and small components.
        """
        agreement = agreement_in_both(self.score, self.plan_score) + self.contrast / CONTRAST_SPREAD
        unusual = np.log(max(self.height_m, LEAST_HEIGHT_M) / USUAL_HEIGHT_M) / HEIGHT_SPREAD
        return agreement - float(np.nan_to_num(unusual**2 / 2))

    @property
    def contrast(self) -> float:
        """Excess of the score over those of perturbed positions, over the root of their spread.

        Walls resemble each other in floors and edges, so that two models agree a little wherever walls coincide, the
        more the larger they are. What only the right position explains vanishes when the model is perturbed.
        """
        if len(self.perturbed_scores) < 2:
            return 0.0
        gain = self.score - float(np.mean(self.perturbed_scores))
        spread = max(float(np.std(self.perturbed_scores)), 1e-6)
        return max(gain, 0.0) / sqrt(spread)


@dataclass(frozen=True)
class AcceptanceOptions:
    """When the best hypothesis is accepted.

    Attributes:
        min_contrast: see `RefinedHypothesis`; docs/benchmarks.md has the values of right and wrong hypotheses.
        max_chance: largest probability that one of as many wrong hypotheses has as much evidence as the best.
        min_rivals, lone_contrast: with fewer hypotheses elsewhere to compare with, the contrast itself must be so high.
        apart_m: hypotheses are elsewhere if they put the model's probes at least this far, on average.
        min_inlier_ratio: of the dense matches (the paper's).
        min_cells, cell_m: cubes in space with inliers: neighbouring matches are correlated.
        max_tilt_deg: by which the registration may tilt the levelled model.
        min_height_m, max_height_m: of the cameras; see `RefinedHypothesis`.
        max_blocked: share of viewing rays that may cross walls.
    """

    min_contrast: float = 11.0
    max_chance: float = 0.01
    min_rivals: int = 2
    lone_contrast: float = 16.0
    apart_m: float = 5.0
    min_inlier_ratio: float = 0.2
    min_cells: int = 10
    cell_m: float = 2.0
    max_tilt_deg: float = 6.0
    min_height_m: float = 0.5
    max_height_m: float = 8.0
    max_blocked: float = 0.1


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
    possible = [c for c in candidates if _possible(c, options)] or list(candidates)
    best, found = possible[0], possible[0].registration
    elsewhere = _elsewhere(possible, probes, options.apart_m)
    second = max((c.contrast for c in elsewhere), default=0.0)
    chance = _chance(best, elsewhere) if elsewhere else 0.0
    diagnostics = {
        **found.diagnostics,
        "contrast": best.contrast,
        "second_contrast": second,
        "evidence": best.evidence,
        "second_evidence": max((c.evidence for c in elsewhere), default=0.0),
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
    needed = options.min_contrast if len(elsewhere) >= options.min_rivals else options.lone_contrast
    criteria = [found_any, *_criteria(best, needed, chance, options)]
    return with_criteria(replace(found, diagnostics=diagnostics), criteria)


def _elsewhere(candidates: Sequence[RefinedHypothesis], probes: Array, apart_m: float) -> list[RefinedHypothesis]:
    """Those of other places than the first, each place once: neighbours share what makes them agree."""
    kept = [candidates[0]]
    for one in candidates[1:]:
        if all(_apart(one.enu_from_level, other.enu_from_level, probes) >= apart_m for other in kept):
            kept.append(one)
    return kept[1:]


def _chance(best: RefinedHypothesis, elsewhere: Sequence[RefinedHypothesis]) -> float:
    """Probability that the best of as many wrong hypotheses has so much evidence; those elsewhere are wrong."""
    null = np.array([one.evidence for one in elsewhere])
    one_more = predictive_tail(best.evidence, null, EVIDENCE_SPREAD, USUAL_RIVALS)
    return float(-np.expm1((len(null) + 1) * np.log1p(-min(one_more, 1 - 1e-12))))


def _criteria(best: RefinedHypothesis, needed: float, chance: float, options: AcceptanceOptions) -> list[Criterion]:
    found, of_matches = best.registration, []
    if found.registered:
        of_matches = [
            criterion("inlier_ratio", found.inlier_ratio, options.min_inlier_ratio),
            criterion("cells", best.cells, options.min_cells),
            criterion("tilt", found.tilt_deg, options.max_tilt_deg),
        ]
    return [
        criterion(ESTIMATE, found.registered, 1),
        criterion("contrast", best.contrast, needed),
        criterion("chance_of_evidence", chance, options.max_chance),
        *of_matches,
        criterion("min_camera_height", best.height_m, options.min_height_m),
        criterion("max_camera_height", best.height_m, options.max_height_m),
        criterion("blocked", best.blocked, options.max_blocked),
    ]


def _possible(candidate: RefinedHypothesis, options: AcceptanceOptions) -> bool:
    """Whether the cameras are at eye height and their viewing rays are free."""
    on_ground = options.min_height_m <= candidate.height_m <= options.max_height_m
    return on_ground and candidate.blocked <= options.max_blocked


def _apart(a: Similarity, b: Similarity, probes: Array) -> float:
    return float(np.linalg.norm(a.apply(probes) - b.apply(probes), axis=1).mean())
