# SPDX-License-Identifier: Apache-2.0
"""What is measured: the default search and matcher, as a similarity between two images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.match import StructuralMatcher, match_hypothesis, search_hypotheses
from skymoor.types import Array, Raster

SCALES = (0.5, 2.0)  # that are searched, pixels of b per pixel of a; all azimuths
INLIER_PX = 4.0
FEWEST = 4  # inliers: two determine a similarity, and fit it exactly


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method says of a pair.

    Attributes:
        b_from_a: (2, 3) similarity from pixels of a to pixels of b, or None where it found none.
        inliers: matches that it fits.
        score: of the search, where there is one.
    """

    b_from_a: Array | None
    inliers: int = 0
    score: float | None = None


Method = Callable[[Raster, Raster], Answer]


def search_and_match(a: Raster, b: Raster) -> Answer:
    """The default search and matcher: the best hypothesis, its cyclic matches, and the similarity that fits them."""
    hypotheses = search_hypotheses(a, b, min_scale=SCALES[0], max_scale=SCALES[1])
    if not hypotheses:
        return Answer(None)
    best, (h, w) = hypotheses[0], a.mask.shape
    matches, _ = match_hypothesis(a, b, best.matrix((h, w)), StructuralMatcher(), rng=np.random.default_rng(0))
    found = similarity_from(matches.px_a, matches.px_b)
    return Answer(found.b_from_a, found.inliers, best.score)


def similarity_from(px_a: Array, px_b: Array) -> Answer:
    """The similarity that most matches (n, 2) agree on, by RANSAC; none where fewer than `FEWEST` do."""
    if len(px_a) < FEWEST:
        return Answer(None)
    matrix, inliers = cv2.estimateAffinePartial2D(
        np.ascontiguousarray(px_a, np.float64),
        np.ascontiguousarray(px_b, np.float64),
        method=cv2.RANSAC,
        ransacReprojThreshold=INLIER_PX,
        maxIters=10000,
        confidence=0.999,
    )
    if matrix is None or (count := int(inliers.sum())) < FEWEST:
        return Answer(None)
    return Answer(np.asarray(matrix, np.float64), count)
