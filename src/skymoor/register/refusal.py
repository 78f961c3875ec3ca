# SPDX-License-Identifier: Apache-2.0
"""When not to believe a registration. A wrong answer stated as right is worse than none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skymoor.register.airborne import RegisterOptions
from skymoor.types import Registration


def judge(
    registration: Registration, scores: Sequence[float], n_matches_2d: int, options: RegisterOptions | None = None
) -> Registration:
    """The registration, or the same with `registered` False and the first reason not to believe it.

    Args:
        registration: what the matches say.
        scores: of the distinct placements after refinement, the believed one first. Right answers scored 86 to 244
            on the real and simulated sets that we measured; wrong ones at most 32 against another place, and 65 beside
            the right one in a square kilometre. Two places that score alike are a coin toss.
        n_matches_2d: matches before lifting.
        options: thresholds.
    """
    options = options or RegisterOptions()
    best, second = scores[0], max(scores[1:], default=0.0)
    diagnostics = {
        **registration.diagnostics,
        "search_score": best,
        "second_score": second,
        "n_matches_2d": float(n_matches_2d),
    }
    registration = replace(registration, diagnostics=diagnostics)
    cells = registration.diagnostics.get("cells", 0.0)
    reasons = [
        (best < options.min_score, f"the best place scores {best:.0f}, chance reaches {options.min_score:.0f}"),
        (
            best < options.min_score_margin * second,
            f"another place is nearly as good: it scores {second:.0f}, the best {best:.0f}",
        ),
        (not registration.registered, registration.reason),
        (
            registration.n_inliers < options.min_inliers,
            f"{registration.n_inliers} matches agree, {options.min_inliers} are needed",
        ),
        (
            registration.inlier_ratio < options.min_inlier_ratio,
            f"only {registration.inlier_ratio:.0%} of the matches agree, {options.min_inlier_ratio:.0%} are needed",
        ),
        (cells < options.min_cells, f"matches agree in {cells:.0f} places only, {options.min_cells} are needed"),
        (
            registration.tilt_deg > options.max_tilt_deg,
            f"the level model would have to tilt by {registration.tilt_deg:.1f} degrees",
        ),
    ]
    for refused, reason in reasons:
        if refused:
            return replace(registration, registered=False, reason=reason)
    return registration
