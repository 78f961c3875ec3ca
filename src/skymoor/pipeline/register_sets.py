# SPDX-License-Identifier: Apache-2.0
"""All sets of photos of a site, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skymoor.pipeline.airborne import register_airborne
from skymoor.pipeline.control import control_of, with_control
from skymoor.pipeline.ground import register_ground_sets, register_ground_sets_on_map
from skymoor.pipeline.job import ComponentResult, Job
from skymoor.pipeline.site import Site


def register_sets(site: Site, jobs: Sequence[Job], note: Callable[[str], None]) -> list[list[ComponentResult]]:
    """The components of each job; `note` is called with one line for each irregularity of the control.

    Control moves airborne components before ground ones are registered to them, so that all products are on it.
    """
    control, lines = control_of(site.control, jobs)
    for line in lines:
        note(line)
    if not site.airborne:
        found = register_ground_sets_on_map(jobs)
        return [with_control(one, control, job) for one, job in zip(found, jobs, strict=True)]
    airborne = with_control(register_airborne(jobs[0]), control, jobs[0])
    ground = register_ground_sets(jobs[1:], airborne, jobs[0].photos)
    return [airborne, *(with_control(one, control, job) for one, job in zip(ground, jobs[1:], strict=True))]
