# SPDX-License-Identifier: Apache-2.0
"""Null distribution of match score and agreement: what decoys of the render reach in the same reference."""

from __future__ import annotations

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.match.align import match_hypothesis
from skymoor.match.cyclic import CyclicOptions
from skymoor.match.decoys import DecoyOptions, search_decoys
from skymoor.match.features import Features
from skymoor.match.hypothesis import ImageHypothesis
from skymoor.match.protocol import DenseMatcher
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.search import SearchOptions
from skymoor.pipeline.search import Extent
from skymoor.registration import NullSample, fit_plan
from skymoor.registration.agreement import Agreement, count_cells
from skymoor.registration.significance import false_alarm_probability
from skymoor.types import Progress, Raster, Reference, Render, no_progress


def null_samples(
    best: ImageHypothesis,
    render: Render,
    reference: Reference,
    features: Features,
    extent: Extent,
    min_confidence: float,
    options: SearchOptions,
    decoys: DecoyOptions,
    matcher: DenseMatcher,
    cyclic: CyclicOptions,
    inlier_m: float,
    cell_m: float,
    *,
    decisive: float,
    seed: int,
    progress: Progress = no_progress,
) -> list[NullSample]:
    """Best scores of decoys, searched and matched as the render is; fewer where the score of `best` is decisive so far.

    Args:
        best: of the render; decoys are searched as it was found.
        render, reference, features, extent, min_confidence, options: as in `search_reference`.
        decoys: how many, and how they are made.
        matcher, cyclic: of the dense matches.
        inlier_m, cell_m: largest residual of an inlier, and side of an independent cell.
        decisive: false-alarm probability below which no further decoy is searched: each costs as much as the search.
        seed: of the matches' consensus.
    """
    low, high = extent.scales(render, reference)
    map_image, rng = reference_raster(reference), np.random.default_rng(seed)
    found = search_decoys(
        nadir_raster(render, min_confidence),
        map_image,
        min_scale=low,
        max_scale=high,
        options=options,
        decoys=decoys,
        azimuths=extent.azimuths,
        features=features,
        by_features=best.by_features,
        enough=lambda scores: false_alarm_probability(best.score, scores) < decisive,
        progress=progress,
    )
    common = (map_image, reference, matcher, cyclic, inlier_m, cell_m, rng)
    return [_sample(decoy, hypothesis, *common) for decoy, hypothesis in found]


def _sample(
    decoy: Raster,
    best: ImageHypothesis,
    map_image: Raster,
    reference: Reference,
    matcher: DenseMatcher,
    cyclic: CyclicOptions,
    inlier_m: float,
    cell_m: float,
    rng: np.random.Generator,
) -> NullSample:
    """Matches of a decoy at its best hypothesis, and how many cells of them agree in plan."""
    pixel_m, b_from_a = reference.grid.pixel_m, best.matrix(decoy.mask.shape)
    matches, _ = match_hypothesis(decoy, map_image, b_from_a, matcher, cyclic, rng=rng)
    inliers = np.zeros(len(matches), bool)
    try:
        plan, east_north = matches.px_a * [1.0, -1.0], reference.grid.enu_from_px(matches.px_b)
        inliers = fit_plan(plan, east_north, np.zeros(len(matches)), inlier_m=inlier_m, rng=rng).inliers
    except (TooFewMatches, DegenerateGeometry):
        pass  # too few matches agree: none do
    cells = count_cells(decoy.mask, map_image.mask, b_from_a, matches.px_b, inliers, cell_m / pixel_m)
    return NullSample(best.score, cells if cells.covered else Agreement(0, 1))
