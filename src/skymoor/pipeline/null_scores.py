# SPDX-License-Identifier: Apache-2.0
"""Null distribution of the search score: what decoys of the render reach in the same reference."""

from __future__ import annotations

import numpy as np

from skymoor.match.decoys import DecoyOptions, decoy_scores
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.search import SearchOptions
from skymoor.pipeline.search import scales_of
from skymoor.registration.significance import false_alarm_probability
from skymoor.types import Progress, Reference, Render, no_progress


def null_scores(
    best_score: float,
    render: Render,
    reference: Reference,
    heights_m: tuple[float, float],
    min_confidence: float,
    options: SearchOptions,
    decoys: DecoyOptions,
    *,
    decisive: float,
    seed: int,
    progress: Progress = no_progress,
) -> list[float]:
    """Best scores of decoys, searched as the render was; fewer where `best_score` is decisive with those so far.

    Args:
        best_score: of the render.
        render, reference, heights_m, min_confidence, options: as in `search_reference`.
        decoys: how many, and how they are made.
        decisive: false-alarm probability below which no further decoy is searched: each costs as much as the search.
        seed: mixes the decoys' parts.
    """
    low, high = scales_of(render, reference, heights_m)
    return decoy_scores(
        nadir_raster(render, min_confidence),
        reference_raster(reference),
        min_scale=low,
        max_scale=high,
        options=options,
        decoys=decoys,
        rng=np.random.default_rng(seed),
        enough=lambda scores: false_alarm_probability(best_score, scores) < decisive,
        progress=progress,
    )
