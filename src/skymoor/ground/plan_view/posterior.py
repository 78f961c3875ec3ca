# SPDX-License-Identifier: Apache-2.0
"""The similarities in plan about one hypothesis that its score leaves open: their mean and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.plan_view.score import PlanScores
from skymoor.types import Array

LIKELIHOOD = 0.42
"""Logarithm of the likelihood ratio per unit of score: of right to wrong places, see docs/benchmarks.md."""
LOG_SCALES = np.linspace(-0.24, 0.24, 7)
AZIMUTHS = np.radians(np.linspace(-9.0, 9.0, 7))
REACH = 4  # cells
ROUNDS = 2  # each from the best of the last one


@dataclass(frozen=True, eq=False)
class PlanPosterior:
    """Of one place.

    Attributes:
        enu_from_level: of the best score; heights are not told.
        score: the best.
        covariance: (4, 4) of log scale, azimuth (rad), east and north (m) at the centroid of the cameras.
    """

    enu_from_level: Similarity
    score: float
    covariance: Array


def plan_posterior(scores: PlanScores, start: Similarity) -> PlanPosterior | None:
    """The posterior of scale, azimuth and place about a hypothesis under a uniform prior; None off the map."""
    best, offsets = start, _offsets(scores.target.grid.pixel_m)
    values = np.zeros(0)
    for _ in range(ROUNDS):
        values = _scores_about(scores, best)
        if not np.isfinite(values).any():
            return None
        best = moved(best, offsets[np.nanargmax(values)], scores.model.cameras)
    values = _scores_about(scores, best)
    highest = float(np.nanmax(values))
    weight = np.nan_to_num(np.exp(LIKELIHOOD * (values - highest)))
    weight /= weight.sum()
    away = offsets - weight @ offsets
    steps = np.array([LOG_SCALES[1] - LOG_SCALES[0], AZIMUTHS[1] - AZIMUTHS[0], *2 * [scores.target.grid.pixel_m]])
    return PlanPosterior(best, highest, (away.T * weight) @ away + np.diag(steps**2 / 12))


def _offsets(cell_m: float) -> Array:
    """Changes (n, 4) of log scale, azimuth, east and north, in the order of `_scores_about`."""
    moves = cell_m * np.arange(-REACH, REACH + 1)
    log_scale, azimuth, south, east = np.meshgrid(LOG_SCALES, AZIMUTHS, moves, moves, indexing="ij")
    return np.stack([log_scale, azimuth, east, -south], axis=-1).reshape(-1, 4)


def _scores_about(scores: PlanScores, start: Similarity) -> Array:
    cameras, found = scores.model.cameras, []
    for log_scale in LOG_SCALES:
        for azimuth in AZIMUTHS:
            turned = moved(start, np.array([log_scale, azimuth, 0.0, 0.0]), cameras)
            found.append(scores.around(turned, REACH).ravel())
    return np.concatenate(found)


def moved(start: Similarity, offset: Array, cameras: Array) -> Similarity:
    """A similarity changed in log scale and azimuth about the centroid of the cameras (n, 3), and to east and north."""
    log_scale, azimuth, east, north = offset.tolist()
    c, s, scale = np.cos(azimuth), np.sin(azimuth), float(np.exp(log_scale))
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    centroid = start.apply(cameras.mean(axis=0)[None])[0]
    return Similarity(scale, rotation, centroid - scale * rotation @ centroid + [east, north, 0.0]) @ start
