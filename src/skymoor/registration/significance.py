# SPDX-License-Identifier: Apache-2.0
"""Significance of a match score, and correlation of heights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t

from skymoor.registration.relief import shared_heights
from skymoor.types import Array32

USUAL_SPREAD, USUAL_DECOYS = 0.12, 6
"""Standard deviation of the logarithms of one render's decoy scores, as measured, and its weight in decoys."""


def false_alarm_probability(score: float, decoys: Sequence[float]) -> float:
    """Probability that one more decoy would reach the score; 1 without decoys to compare with.

    The decoys' scores are modelled as log-normal; their spread is a weighted mean of the observed and the usual one,
    so that four decoys of similar score do not make it too small (Student's predictive distribution).
    """
    if not decoys or score <= 0:
        return 1.0
    logs, n = np.log(np.maximum(decoys, 1e-3)), len(decoys)
    squares = float(((logs - logs.mean()) ** 2).sum()) + USUAL_DECOYS * USUAL_SPREAD**2
    dof = n - 1 + USUAL_DECOYS
    spread = np.sqrt(squares / dof * (1 + 1 / n))
    return float(t.sf((np.log(score) - logs.mean()) / spread, dof))


def height_agreement(model: Array32, reference: Array32, pixel_m: float, *, blur_m: float = 1.0) -> float | None:
    """Correlation of two height maps (h, w) in metres on one grid, NaN where unknown, after removal of a plane.

    None where they share less than 20 areas of a few metres, or where one of them is flat to half a metre.
    """
    shared = shared_heights(model, reference, pixel_m, blur_m)
    if shared is None:
        return None
    plane, *blurred, _ = shared
    residuals = [x - plane @ np.linalg.lstsq(plane, x.astype(np.float64), rcond=None)[0] for x in blurred]
    if min(float(x.std()) for x in residuals) < 0.5:
        return None
    return float(np.corrcoef(residuals[0], residuals[1])[0, 1])
