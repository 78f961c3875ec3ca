# SPDX-License-Identifier: Apache-2.0
"""A nadir render on the reference: searched with decoys, matched, and registered or refused.

Models from photos and models that were given take the same way from here.
"""

from __future__ import annotations

import numpy as np

from skymoor.match import ImageHypothesis
from skymoor.pipeline.job import Job, MapHypothesis, Searched
from skymoor.pipeline.null_samples import null_samples
from skymoor.pipeline.register_best import Prior, register_best
from skymoor.pipeline.search import Extent, places_of, search_reference
from skymoor.registration import inlier_limit_m
from skymoor.types import Matches3D, Reference, Registration, Render

DECISIVE = 1 / 10
"""Share of the largest false-alarm probability below which further decoys could not change the verdict."""


def search_render(name: str, render: Render, extent: Extent, min_confidence: float, job: Job) -> Searched:
    """Hypotheses, and what decoys of the render reach in the same search.

    Heights of the render whose confidence is below `min_confidence` are not compared: none are where it exceeds 1.
    """
    options, match, store = job.options, job.options.match, job.store
    given = (render, job.reference, job.features(), extent, min_confidence, match.search)
    hypotheses = store.stage(f"{name}.search", search_reference, *given, progress=job.track("search"))
    if not hypotheses:
        return Searched([], [])
    decoys = store.stage(
        f"{name}.decoys",
        null_samples,
        hypotheses[0],
        *given,
        match.decoys,
        options.engines.dense_matcher(match.matcher),
        match.cyclic,
        inlier_limit_m(job.reference.grid.pixel_m, options.register),
        options.register.correlation_m,
        decisive=options.register.max_false_alarm * DECISIVE,
        seed=job.seed,
        progress=job.track("decoys"),
    )
    return Searched(hypotheses, decoys)


def register_render(
    name: str, searched: Searched, render: Render, prior: Prior, min_confidence: float, job: Job
) -> tuple[Registration, Matches3D]:
    """The registration that most independent matches confirm, accepted or refused."""
    options, match = job.options, job.options.match
    assert job.files is not None
    settings = (job.files, min_confidence, match.search)
    first = searched.hypotheses[: match.candidates]
    places = job.store.stage(f"{name}.places", places_of, first, render, job.reference, *settings)
    return job.store.stage(
        f"{name}.register",
        register_best,
        searched.hypotheses,
        places,
        searched.decoys,
        render,
        job.reference.grid,
        options.engines.dense_matcher(match.matcher),
        prior,
        min_confidence=min_confidence,
        cyclic=match.cyclic,
        lift_options=options.lift,
        options=options.register,
        seed=job.seed,
    )


def hypothesis_on_map(hypothesis: ImageHypothesis, render: Render, reference: Reference) -> MapHypothesis:
    """A hypothesis of the search in metres."""
    east, north = reference.grid.enu_from_px(np.array([hypothesis.centre_px]))[0].tolist()
    metres_per_unit = hypothesis.scale * reference.grid.pixel_m / render.view.pixel
    azimuth_deg = float(np.degrees(hypothesis.azimuth_rad) % 360)
    return MapHypothesis(hypothesis.score, east, north, azimuth_deg, metres_per_unit)
