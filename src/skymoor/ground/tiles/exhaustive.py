# SPDX-License-Identifier: Apache-2.0
"""All photos with all tiles (paper, section 3.4, exhaustive matching)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.tiles.evidence import ConsensusOptions, evidence_of
from skymoor.ground.tiles.images import airborne_tiles, ground_photo
from skymoor.match import DenseMatcher
from skymoor.types import DepthMap, Progress, Registration, Render, no_progress


def exhaustive(
    maps_level: Sequence[DepthMap],
    renders: Sequence[Render],
    matcher: DenseMatcher,
    options: ConsensusOptions | None = None,
    *,
    enu_from_render: Similarity | None = None,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> Registration:
    """Registration of a ground component by matching each of its photos with each tile of the airborne renders.

    The tiles with most matches yield a similarity each; the one that explains most matches of all pairs is fitted
    to them and then to the surface by ICP. The share of inliers is taken over the matches of the best tiles of
    each photo: the others are known to be wrong.

    Args:
        maps_level: the photos with their depth, z up, in any scale, undistorted.
        renders: of the airborne model: from above and from the sides.
        matcher: between a photo and a tile.
        options: see there.
        enu_from_render: by default the renders are in ENU metres.
        rng: for the consensus; the same state gives the same result, up to rounding.
        progress: counts the pairs.

    Returns:
        the registration. Its diagnostics hold "pairs" evaluated out of "pairs_in_all", "tiles" and "photos", "score"
        and "second_score" (inliers of the best transform, and of the best one elsewhere), "photos_agree", "cells",
        and "icp_helped", "icp_moved_m", "icp_overlap" where ICP ran. The covariance is of the matches.

    Raises `DegenerateGeometry` where no photo has depth, or no render shows anything.
    """
    options = options or ConsensusOptions()
    photos = tuple(ground_photo(depth_map, options.pictures) for depth_map in maps_level)
    airborne = airborne_tiles(renders, options.pictures, enu_from_render=enu_from_render)
    evidence = evidence_of(photos, airborne, matcher, options, rng)
    total = len(photos) * len(airborne.tiles)
    pairs = []
    for photo in range(len(photos)):
        for pair in evidence.match(photo, range(len(airborne.tiles))):
            pairs.append(pair)
            progress(len(pairs), total)
    hypotheses = [evidence.hypothesis(pair.matches, level=False) for pair in evidence.best_pairs(pairs)]
    found = evidence.conclude(pairs, [one for one in hypotheses if one is not None])
    counts = {"pairs": total, "pairs_in_all": total, "tiles": len(airborne.tiles), "photos": len(photos)}
    return replace(found, diagnostics={**found.diagnostics, **{key: float(n) for key, n in counts.items()}})
