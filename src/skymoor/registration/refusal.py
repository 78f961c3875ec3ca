# SPDX-License-Identifier: Apache-2.0
"""When not to believe a registration. A wrong answer stated as right is worse than none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skymoor.registration.airborne import RegisterOptions
from skymoor.registration.chance import chance_probability
from skymoor.types import Registration


def judge(
    registration: Registration,
    scores: Sequence[float],
    n_matches_2d: int,
    options: RegisterOptions | None = None,
    *,
    decoys: Sequence[float] = (),
    heights: float | None = None,
) -> Registration:
    """The registration, or the same with `registered` False and the first reason not to believe it.

    Args:
        registration: what the matches say.
        scores: of the distinct placements after refinement, the believed one first. Right answers scored 86 to 244
            on the real and simulated sets that we measured; wrong ones at most 32 against another place, and 65 beside
            the right one in a square kilometre. Two places that score alike are a coin toss.
        n_matches_2d: matches before lifting.
        options: thresholds.
        decoys: scores of pictures that lie nowhere, see `decoy_scores`; without them chance has the limit `min_score`
            alone.
        heights: how well heights agree at the believed place, see `height_agreement`; None where they cannot tell.
    """
    options = options or RegisterOptions()
    best, second = scores[0], max(scores[1:], default=0.0)
    diagnostics = {
        **registration.diagnostics,
        "search_score": best,
        "second_score": second,
        "n_matches_2d": float(n_matches_2d),
    }
    chance = chance_probability(best, decoys)
    if decoys:
        diagnostics |= {"decoy_score": float(max(decoys)), "chance_probability": chance}
    if heights is not None:
        diagnostics["height_agreement"] = heights
    registration = replace(registration, diagnostics=diagnostics)
    cells = registration.diagnostics.get("cells", 0.0)
    reasons = [
        (best < options.min_score, f"the best place scores {best:.0f}, chance reaches {options.min_score:.0f}"),
        (
            bool(decoys) and chance > options.max_chance,
            f"the best place scores {best:.0f}, and pictures that lie nowhere reach {max(decoys, default=0):.0f} here: "
            f"it may be chance ({chance:.1%})",
        ),
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
        (
            heights is not None and heights < options.min_height_agreement,
            f"the model's heights do not go with the reference's there (correlation {heights or 0:.2f})",
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
