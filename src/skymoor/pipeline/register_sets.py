# SPDX-License-Identifier: Apache-2.0
"""All sets of photos of a site, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NoReturn

from skymoor.pipeline.airborne import register_airborne
from skymoor.pipeline.control import control_of, with_control
from skymoor.pipeline.ground import register_ground_sets, register_ground_sets_on_map
from skymoor.pipeline.job import ComponentResult, Job
from skymoor.pipeline.site import Site
from skymoor.pipeline.stopping import StopAfter, StoppedAfter


def register_sets(site: Site, jobs: Sequence[Job], note: Callable[[str], None]) -> list[list[ComponentResult]]:
    """The components of each job; `note` is called with one line for each irregularity of the control.

    Control moves airborne components before ground ones are registered to them, so that all products are on it.
    """
    control, lines = control_of(site.control, jobs)
    for line in lines:
        note(line)
    if jobs[0].stop_after:  # control must not place components that have not come to their own registration
        control = None
    if not site.airborne:
        found = register_ground_sets_on_map(jobs)
        return [with_control(one, control, job) for one, job in zip(found, jobs, strict=True)]
    airborne = with_control(register_airborne(jobs[0]), control, jobs[0])
    ground = register_ground_sets(jobs[1:], airborne, jobs[0].photos)
    return [airborne, *(with_control(one, control, job) for one, job in zip(ground, jobs[1:], strict=True))]


def stop_sets(step: StopAfter, site: Site, jobs: Sequence[Job], note: Callable[[str], None]) -> NoReturn:
    """Do all up to a step, which stays in the cache, and raise `StoppedAfter`.

    `note` is also called for each set and component that did not come so far.
    """
    stopped = StoppedAfter(step)
    found = register_sets(site, [replace(job, stop_after=step) for job in jobs], note)
    for job, items in zip(jobs, found, strict=True):
        if not items:
            note(f"{job.name}: no model was found in these photos")
        for item in items:
            if item.registration.reason != str(stopped):
                note(f"{item.name}: {item.registration.reason}")
    raise stopped
