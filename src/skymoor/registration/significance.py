# SPDX-License-Identifier: Apache-2.0
"""False-alarm probability of a registration, from what decoys reach in the same reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr  # scipy.stats takes a second to load

from skymoor.registration.agreement import Agreement
from skymoor.types import Array

USUAL_DECOYS = 6
"""Weight, in decoys, of the usual spread of their figures beside the observed one."""
SCORE_SPREAD = 0.12  # of the logarithms of one render's decoy scores, as measured
CELLS_SPREAD = 0.75
"""Of the logits of the shares of agreeing cells at wrong hypotheses: 0.65 to 0.85 for five pairs of photos and
reference, 85 hypotheses in all."""


@dataclass(frozen=True)
class NullSample:
    """What a decoy reached at its best hypothesis: match score and agreement in plan."""

    score: float
    agreement: Agreement


def false_alarm_probability(score: float, decoys: Sequence[float]) -> float:
    """Probability that one more decoy would reach the score; 1 without decoys to compare with.

    The decoys' scores are modelled as log-normal; their spread is a weighted mean of the observed and the usual one,
    so that four decoys of similar score do not make it too small (Student's predictive distribution).
    """
    if not decoys or score <= 0:
        return 1.0
    return _tail(float(np.log(score)), np.log(np.maximum(decoys, 1e-3)), SCORE_SPREAD)


def agreement_probability(found: Agreement, decoys: Sequence[Agreement]) -> float:
    """Probability that a decoy's matches would agree on as large a share of its cells; 1 without decoys.

    The logits of the shares are modelled as normal, with half a cell added to both sides.
    """
    if not decoys:
        return 1.0
    return _tail(_logit(found), np.array([_logit(one) for one in decoys]), CELLS_SPREAD)


def combined_probability(probabilities: Sequence[float]) -> float:
    """One p-value of several that may depend on each other (Cauchy combination: Liu and Xie, JASA 2020)."""
    clipped = np.clip(probabilities, 1e-15, 1 - 1e-15)
    statistic = float(np.mean(np.tan((0.5 - clipped) * np.pi)))
    return float(0.5 - np.arctan(statistic) / np.pi) if statistic < 1e6 else 1 / (np.pi * statistic)


def _tail(value: float, null: Array, usual_spread: float) -> float:
    """Of Student's predictive distribution of a normal null sample (n,), with a usual spread beside the observed."""
    n = len(null)
    squares = float(((null - null.mean()) ** 2).sum()) + USUAL_DECOYS * usual_spread**2
    dof = n - 1 + USUAL_DECOYS
    spread = np.sqrt(squares / dof * (1 + 1 / n))
    return float(stdtr(dof, -(value - null.mean()) / spread))


def _logit(agreement: Agreement) -> float:
    return float(np.log((agreement.agreeing + 0.5) / (agreement.covered - agreement.agreeing + 0.5)))
