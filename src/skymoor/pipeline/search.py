# SPDX-License-Identifier: Apache-2.0
"""Search of the nadir render in the reference, at any azimuth and at any of the flying heights in question."""

from __future__ import annotations

from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.search import ImageHypothesis, SearchOptions, search_hypotheses
from skymoor.types import Progress, Reference, Render, no_progress


def search_reference(
    render: Render,
    reference: Reference,
    heights_m: tuple[float, float],
    min_confidence: float,
    options: SearchOptions,
    *,
    progress: Progress = no_progress,
) -> list[ImageHypothesis]:
    """Hypotheses of position, azimuth and scale, best first; empty where the reference is too small at every height.

    `heights_m` are the least and the largest metres per unit of the level frame, which is the flying height.
    """
    low, high = scales_of(render, reference, heights_m)
    return search_hypotheses(
        nadir_raster(render, min_confidence),
        reference_raster(reference),
        min_scale=low,
        max_scale=high,
        options=options,
        progress=progress,
    )


def scales_of(render: Render, reference: Reference, heights_m: tuple[float, float]) -> tuple[float, float]:
    """Pixels of the reference per pixel of the render, for flying heights."""
    px_per_metre = render.view.pixel / reference.grid.pixel_m
    return heights_m[0] * px_per_metre, heights_m[1] * px_per_metre
