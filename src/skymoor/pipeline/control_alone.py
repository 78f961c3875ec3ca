# SPDX-License-Identifier: Apache-2.0
"""A component that was not found on the map, placed by control alone: the classical absolute orientation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skymoor.control import Control, ControlResult, Located, PosedCameras, examine, locate
from skymoor.control.adjust import FREE_M2
from skymoor.control.rows import totals_of
from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity, ransac_similarity
from skymoor.pipeline.job import ComponentResult, Job
from skymoor.pipeline.registered import posed_cameras, prior_of
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.types import Array, HeightVerdict, Registration

LEAST = 4
"""Surveyed positions with heights that agree: three determine the seven parameters, and a fourth tells whether one of
them is wrong."""
START_M = 2.0
"""Residual of a start from which data snooping goes on: mistaken points are farther off, measured ones nearer."""
MOST_TURN_DEG = 5.0
"""Standard deviation of the rotation from which on control does not determine it."""
WIDE = np.diag([1.0] * 4 + [FREE_M2] * 3)  # log scale, radians and metres of which nothing is known


def place_alone(item: ComponentResult, control: Control, job: Job) -> ComponentResult:
    """The component where its control puts it, registered; as it was, with the reason, where that is not certain.

    Nothing else is known of it, so no residual is compared with a prediction.
    """
    cameras = PosedCameras(item.component.cameras, None, np.zeros((len(item.component.cameras), 3)))
    located = [one for one in locate(control, cameras, np.zeros(3)) if not one.reason and one.place is not None]
    solid = [one for one in located if one.place is not None and np.isfinite(one.place.height)]
    if not solid:
        return item
    if len(solid) < LEAST:
        return _not_placed(item, f"{len(solid)} surveyed positions with heights in it, at least {LEAST} are needed")
    target = np.array([_enu(one, job) for one in solid])
    try:
        rng = np.random.default_rng(job.seed)
        source = np.array([one.xyz for one in solid])
        start = ransac_similarity(source, target, inlier_m=START_M, rng=rng, level=False).transform
    except (TooFewMatches, DegenerateGeometry):
        return _not_placed(item, "its positions lie on one line, or no three of them agree with a fourth")
    return _placed(item, replace(item, registration=_registration(start, target.mean(axis=0))), control, job)


def _placed(item: ComponentResult, started: ComponentResult, control: Control, job: Job) -> ComponentResult:
    """From a start that some of the control agrees with; `item` is what was refused on the map."""
    prior = replace(prior_of(started, job.reference), reference_known=True, heights_known=True)
    found = examine(replace(control, use=True), posed_cameras(started), job.reference.frame, prior)
    if found is None or found.adjusted is None:
        return _not_placed(item, "nothing of it can be used" if found is None else found.reason)
    count = sum(row.use == "control" and row.kind != "scale bar" and row.known_m[2] is not None for row in found.rows)
    if count < LEAST:
        return _not_placed(item, f"{count} surveyed positions in it agree, at least {LEAST} are needed")
    if np.sqrt(np.diag(found.adjusted.covariance)[1:4]).max() > np.radians(MOST_TURN_DEG):
        return _not_placed(item, "its positions lie nearly on one line; measure some aside of it")
    unknown = {"inside_ellipsoid": None, "inside_ce90": None, "inside_le90": None, "distance": None}
    rows = tuple(replace(row, residual_m=(), sigma_m=(), **unknown) for row in found.rows)  # type: ignore[arg-type]
    notes = (f"not found on the map ({item.registration.reason}), and placed by control alone", *found.notes)
    registration = with_criteria(started.registration, [criterion("control_points", count, LEAST)])
    result = ControlResult(rows, totals_of(rows), used=True, notes=notes, adjusted=found.adjusted)
    return replace(item, registration=registration, control=result)


def _registration(start: Similarity, centre: Array) -> Registration:
    heights = HeightVerdict("OFFSET_ONLY", "heights hang on control alone")
    return Registration(
        registered=True,
        reason="",
        enu_from_level=start,
        covariance=WIDE,
        centroid_enu=centre,
        heights=heights,
        tilt_deg=0.0,
    )


def _enu(one: Located, job: Job) -> Array:
    assert one.place is not None
    enu: Array = job.reference.frame.enu_from_lla(one.place.lat, one.place.lon, one.place.height)[0]
    return enu


def _not_placed(item: ComponentResult, reason: str) -> ComponentResult:
    reason = f"it was not found on the map, and control alone does not place it: {reason}"
    return replace(item, control=ControlResult((), totals_of([]), reason=reason))
