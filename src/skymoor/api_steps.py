# SPDX-License-Identifier: Apache-2.0
"""Steps of the method that scripts call one by one, where the stages themselves take more than a script has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from skymoor.errors import TooFewMatches
from skymoor.match import CyclicOptions, DenseMatcher, SearchOptions, StructuralMatcher, match_hypothesis
from skymoor.match.decoys import decoy_scores
from skymoor.match.search import search_hypotheses
from skymoor.orient import estimate_gravity, level_from_gravity
from skymoor.registration.significance import false_alarm_probability
from skymoor.types import Array, Component, Matches2D, Progress, Raster, no_progress


@dataclass(frozen=True, eq=False)
class RasterMatch:
    """The position of one raster in another, and matches.

    Attributes:
        b_from_a: (2, 3) affine, a similarity, from pixels of a to pixels of b.
        scale: pixels of b per pixel of a.
        azimuth_deg: by which a is turned clockwise in b, 0 to 360.
        score: of the search, in standard deviations of noise; `null_scores` are those of decoys.
        false_alarm_probability: of the score: how likely one more decoy reaches it.
        matches: cyclically consistent pixels of a and b.
    """

    b_from_a: Array
    scale: float
    azimuth_deg: float
    score: float
    null_scores: tuple[float, ...]
    false_alarm_probability: float
    matches: Matches2D


def match_rasters(
    a: Raster,
    b: Raster,
    *,
    min_scale: float,
    max_scale: float,
    matcher: DenseMatcher | None = None,
    options: SearchOptions | None = None,
    cyclic: CyclicOptions | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> RasterMatch:
    """Find raster `a` in raster `b` at any azimuth, scale and position, and match the two densely (paper, section 3.2).

    Args:
        a, b: colours (h, w, 3), mask, and heights where they are known.
        min_scale, max_scale: of what is searched, pixels of b per pixel of a.
        matcher: of the dense matches; the structural one without.
        options, cyclic: of the search and of the matches.
        seed: of random choices.

    Raises:
        TooFewMatches: b is too small to hold a at any scale.
    """
    common: dict[str, Any] = {"min_scale": min_scale, "max_scale": max_scale, "options": options}
    hypotheses = search_hypotheses(a, b, **common, progress=progress)
    if not hypotheses:
        raise TooFewMatches("the raster that is searched is too small to hold the other at any scale")
    best = hypotheses[0]
    null = decoy_scores(a, b, **common)
    b_from_a, rng = best.matrix(a.mask.shape), np.random.default_rng(seed)
    matches, _ = match_hypothesis(a, b, b_from_a, matcher or StructuralMatcher(), cyclic, rng=rng)
    azimuth_deg = float(np.degrees(best.azimuth_rad) % 360)
    probability = false_alarm_probability(best.score, null)
    return RasterMatch(b_from_a, best.scale, azimuth_deg, best.score, tuple(null), probability, matches)


def level_component(component: Component, *, seed: int = 0) -> Component:
    """An airborne component with z up, by its points and cameras (paper, section 3.1, gravity vector estimation).

    Raises:
        DegenerateGeometry: its points and cameras do not determine up.
    """
    gravity = estimate_gravity(component, rng=np.random.default_rng(seed))
    return component.transformed(level_from_gravity(component, gravity))
