# SPDX-License-Identifier: Apache-2.0
"""Hypotheses of single walls, and those on which most walls of a component agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skymoor.geometry import Similarity
from skymoor.types import Array


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
        if all(apart(one.enu_from_level, q.enu_from_level, probes) >= 2 * options.near_m for q in kept):
            kept.append(one)
    return kept[: options.keep]


def apart(a: Similarity, b: Similarity, probes: Array) -> float:
    """Mean distance of the probes (n, 3) under two similarities."""
    return float(np.linalg.norm(a.apply(probes) - b.apply(probes), axis=1).mean())
