# SPDX-License-Identifier: Apache-2.0
"""Dense matches at the best hypotheses of the search, and the registration with most independent inliers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skymoor.match.align import match_hypothesis
from skymoor.match.cyclic import CyclicOptions
from skymoor.match.protocol import DenseMatcher
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.search import ImageHypothesis
from skymoor.pipeline.overlay import warp_to_reference
from skymoor.registration import LiftOptions, RegisterOptions, decide, height_agreement, lift, register
from skymoor.types import Matches3D, Reference, Registration, Render


def register_best(
    hypotheses: Sequence[ImageHypothesis],
    decoys: Sequence[float],
    render: Render,
    reference: Reference,
    matcher: DenseMatcher,
    *,
    candidates: int,
    min_confidence: float,
    cyclic: CyclicOptions,
    lift_options: LiftOptions,
    options: RegisterOptions,
    seed: int,
) -> tuple[Registration, Matches3D]:
    """The registration of the best hypothesis, accepted or refused, and its matches.

    Args:
        hypotheses: hypotheses of the search, best first; `candidates` of them are matched.
        decoys: null scores of the same search.
        render, reference: what is matched, by `matcher`.
        min_confidence: heights of the render below it are left out.
        cyclic, lift_options, options: of the steps.
        seed: of random choices.
    """
    rng = np.random.default_rng(seed)
    image, map_image = nadir_raster(render, min_confidence), reference_raster(reference)
    results: list[tuple[Registration, Matches3D]] = []
    for k, hypothesis in enumerate(hypotheses[:candidates]):
        b_from_a = hypothesis.matrix(image.mask.shape)
        metres_per_level = hypothesis.scale * reference.grid.pixel_m / render.view.pixel
        matches_2d, _ = match_hypothesis(image, map_image, b_from_a, matcher, cyclic, rng=rng)
        matches = lift(matches_2d, render, reference, metres_per_level, lift_options)
        registration = register(matches, reference.grid.pixel_m, options, rng=rng)
        heights = None
        if registration.registered:
            _, up = warp_to_reference(render, registration, reference, min_confidence)
            heights = height_agreement(up, reference.height, reference.grid.pixel_m)
        scores = [hypothesis.score, *(other.score for j, other in enumerate(hypotheses) if j != k)]
        found = decide(registration, scores, len(matches_2d), options, decoys=decoys, heights=heights)
        results.append((found, matches))
    return max(results, key=lambda result: (result[0].registered, result[0].diagnostics.get("cells", 0.0)))
