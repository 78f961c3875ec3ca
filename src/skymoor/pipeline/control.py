# SPDX-License-Identifier: Apache-2.0
"""Components compared with control, and moved onto it where that is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skymoor.control import Adjusted, Control, examine, resolved
from skymoor.errors import InputError
from skymoor.geometry import moved_similarity, tilt_deg
from skymoor.pipeline.control_alone import place_alone
from skymoor.pipeline.job import ComponentResult, Job, or_else
from skymoor.pipeline.registered import posed_cameras, prior_of
from skymoor.pipeline.site_control import ControlFiles
from skymoor.types import HeightVerdict, Reference, Registration

FAR_M = 1000.0
"""From the reference, beside its own size, where no control of it lies."""


def control_of(files: ControlFiles | None, jobs: Sequence[Job]) -> tuple[Control | None, list[str]]:
    """The control of a site with the names of its photos, and lines about it.

    Raises `InputError` for what cannot belong to the site, see `resolved`, such as a position far from the reference.
    """
    control = None if files is None else files.given
    if control is None:
        return None, []
    sizes = {
        name: job.photos.sizes[k] if job.photos.sizes else None
        for job in jobs
        for k, name in enumerate(job.photos.names)
    }
    _require_near(control, jobs[0].reference)
    return resolved(control, sizes)


def _require_near(control: Control, reference: Reference) -> None:
    west, south, east, north = reference.grid.bounds
    reach = FAR_M + max(east - west, north - south)
    for name, place in control.places:
        e, n, _ = reference.frame.enu_from_lla(place.lat, place.lon, reference.frame.height_m)[0].tolist()
        gap = np.hypot(max(west - e, e - east, 0.0), max(south - n, n - north, 0.0))
        if not gap <= reach:
            raise InputError(
                f"{place.where}: {name} lies at latitude {place.lat:.5f}, longitude {place.lon:.5f}, "
                f"{gap / 1000:.0f} km from the reference; is the CRS right, and are its coordinates in the right order?"
            )


def with_control(items: Sequence[ComponentResult], control: Control | None, job: Job) -> list[ComponentResult]:
    """Components compared with control; those that stand on the reference itself are moved onto it if it is to be used.

    A component for which that fails stays as it is.
    """
    if control is None:
        return list(items)
    return [_or_as_it_is(item, control, job) for item in items]


def _or_as_it_is(item: ComponentResult, control: Control, job: Job) -> ComponentResult:
    return or_else(lambda: _with(item, control, job), lambda _: item, item.name)


def _with(item: ComponentResult, control: Control, job: Job) -> ComponentResult:
    found = item.registration
    if not item.component.cameras:
        return item
    if not found.registered:
        can_be_placed = control.use and item.base is None and item.render is not None
        return _moved(place_alone(item, control, job)) if can_be_placed else item
    if found.covariance is None:
        return item
    control = replace(control, use=control.use and item.base is None)
    result = examine(control, posed_cameras(item), job.reference.frame, prior_of(item, job.reference))
    return item if result is None else _moved(replace(item, control=result))


def _moved(item: ComponentResult) -> ComponentResult:
    """With the correction that control asks for, if it was used."""
    result = item.control
    if result is None or result.adjusted is None:
        return item
    with_height = any(row.use == "control" and row.after_m[2:] not in ((), (None,)) for row in result.rows)
    return replace(item, registration=moved(item.registration, result.adjusted, with_height=with_height))


def moved(found: Registration, adjusted: Adjusted, *, with_height: bool) -> Registration:
    """The registration corrected by control; its matches keep their residuals against the reference.

    The focal length stays what it is: by how much control would change it counts as an error. Heights about which the
    reference said nothing hang on control where that has some.
    """
    assert found.enu_from_level is not None and found.centroid_enu is not None
    step, heights = adjusted.correction, found.heights
    transform = moved_similarity(found.enu_from_level, step[:7], found.centroid_enu)
    absolute = adjusted.covariance.copy()
    absolute[7, 7] += step[7] ** 2
    if with_height and heights is not None and heights.status == "NOT_CONFIRMED":
        heights = _hung(heights)
    return replace(
        found,
        enu_from_level=transform,
        tilt_deg=tilt_deg(transform),
        covariance=absolute[:7, :7],
        absolute=absolute,
        centroid_enu=found.centroid_enu + step[4:7],
        heights=heights,
    )


def _hung(heights: HeightVerdict) -> HeightVerdict:
    reason = f"heights hang on control; without it: {heights.reason}"
    return replace(heights, status="OFFSET_ONLY", reason=reason)
