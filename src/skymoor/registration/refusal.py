# SPDX-License-Identifier: Apache-2.0
"""Acceptance criteria of airborne registrations: a wrong registration that is accepted is worse than none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skymoor.registration.agreement import Agreement
from skymoor.registration.airborne import RegisterOptions
from skymoor.registration.criteria import ESTIMATE, criterion, with_criteria
from skymoor.registration.significance import (
    NullSample,
    agreement_probability,
    combined_probability,
    false_alarm_probability,
)
from skymoor.types import Criterion, Registration

WITHOUT_DECOYS = 36.0
"""Least match score where no decoy says what chance reaches. Decoys of six models reached 10 to 72, right windows 32
to 153: no fixed score tells them apart (docs/decisions/0034)."""


def decide(
    registration: Registration,
    scores: Sequence[float],
    n_matches_2d: int,
    options: RegisterOptions | None = None,
    *,
    agreement: Agreement | None = None,
    decoys: Sequence[NullSample] = (),
) -> Registration:
    """The registration with all criteria that were checked, accepted or refused with the first that failed.

    Only the place on the map is decided here; heights have their own verdict.

    Args:
        registration: as estimated from the matches.
        scores: of the distinct hypotheses after refinement, this one first.
        n_matches_2d: matches before lifting.
        options: thresholds.
        agreement: independent cells in which the matches agree with the transform; None where there is none.
        decoys: what decoys reached; without them the score must be at least `WITHOUT_DECOYS`.
    """
    options = options or RegisterOptions()
    best, second = scores[0], max(scores[1:], default=0.0)
    agreement = agreement or Agreement(0, 0)
    diagnostics = {
        **registration.diagnostics,
        "search_score": best,
        "second_score": second,
        "n_matches_2d": float(n_matches_2d),
        "cells": float(agreement.agreeing),
        "covered_cells": float(agreement.covered),
    }
    least = options.min_score if decoys else max(options.min_score, WITHOUT_DECOYS)
    criteria = [criterion("match_score", best, least)] if least > 0 else []
    if decoys:
        of_cells = agreement_probability(agreement, [decoy.agreement for decoy in decoys])
        probability = combined_probability([false_alarm_probability(best, [decoy.score for decoy in decoys]), of_cells])
        reached = max(decoys, key=lambda decoy: decoy.score)
        diagnostics |= {"decoy_score": reached.score, "false_alarm_probability": probability}
        diagnostics |= {"decoy_cells": float(max(decoy.agreement.agreeing for decoy in decoys))}
        criteria.append(criterion("false_alarm", probability, options.max_false_alarm))
        criteria.append(criterion("agreement", of_cells, options.max_chance_agreement))
    criteria += [
        criterion("competing_score", best, options.min_score_margin * second),
        criterion(ESTIMATE, registration.registered, 1),
    ]
    if registration.registered:
        criteria += _of_matches(registration, options, agreement)
    return with_criteria(replace(registration, diagnostics=diagnostics), criteria)


def _of_matches(registration: Registration, options: RegisterOptions, agreement: Agreement) -> list[Criterion]:
    """Criteria of an estimated transform."""
    return [
        criterion("inliers", registration.n_inliers, options.min_inliers),
        criterion("cells", agreement.agreeing, options.min_cells),
        criterion("tilt", registration.tilt_deg, options.max_tilt_deg),
    ]
