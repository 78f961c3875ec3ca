# SPDX-License-Identifier: Apache-2.0
"""The method for ground photos on one page (paper, section 3.4): each component is laid on the airborne model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import skymoor.facade
import skymoor.geometry
import skymoor.ground
import skymoor.match
import skymoor.register
from skymoor.errors import DegenerateGeometry
from skymoor.ground import (
    AirborneWalls,
    CameraWitness,
    airborne_walls,
    hear_cameras,
    moved_map,
    register_ground,
    walls_picture,
)
from skymoor.orient import estimate_ground_gravity, level_from_gravity
from skymoor.pipeline import Job, Placed, densify_component, reconstruct_set, refused
from skymoor.types import Component, Image, Registration


def register_ground_sets(jobs: Sequence[Job], airborne: Sequence[Placed]) -> list[list[Placed]]:
    """Every component of every set of ground photos, placed on the airborne model or refused (paper, section 3.4)."""
    bases = [item for item in airborne if item.registration.registered]
    walls = _walls(bases, jobs[0]) if bases and jobs else None
    found = []
    for job in jobs:
        components = reconstruct_set(f"{job.name}.reconstruct", job, job.options.ground.reconstruct)
        found.append([_place_ground(f"{job.name}-{k}", c, walls, bases, job) for k, c in enumerate(components)])
    return found


def _walls(bases: Sequence[Placed], job: Job) -> AirborneWalls | None:
    """The walls of all registered airborne components; None where they show no surface."""
    options = job.options.ground.place

    def compute() -> AirborneWalls | None:
        transforms = [(base, base.registration.enu_from_level) for base in bases]
        maps = [
            moved_map(m, enu_from_level) for base, enu_from_level in transforms if enu_from_level for m in base.depths
        ]
        try:
            return airborne_walls(maps, options, rng=np.random.default_rng(job.seed), progress=job.track("walls"))
        except DegenerateGeometry:
            return None

    return job.store.stage(
        "walls",
        compute,
        options=(options, job.seed),
        after=[f"{base.name}.{stage}" for base in bases for stage in ("depths", "register")],
        code=[skymoor.facade, skymoor.ground, skymoor.geometry],
    )


def _place_ground(
    name: str, component: Component, walls: AirborneWalls | None, bases: Sequence[Placed], job: Job
) -> Placed:
    """Lay one ground component on the airborne model."""
    options = job.options.ground
    try:
        if walls is None:
            raise DegenerateGeometry("no airborne component is registered that it could be laid on")
        gravity = estimate_ground_gravity(component, job.photos, options.upright)
        level_from_sfm = level_from_gravity(component, gravity)
        level = component.moved(level_from_sfm)
        depths = densify_component(name, level, level_from_sfm, job, f"{job.name}.reconstruct", options.densify)
    except DegenerateGeometry as error:
        return refused(name, component, str(error))
    airborne = walls

    def compute() -> tuple[Registration, list[CameraWitness], Image | None]:
        rng = np.random.default_rng(job.seed)
        found = register_ground(depths, airborne, options.place, rng=rng, progress=job.track(f"{name}: walls"))
        if not found.registered or found.enu_from_level is None:
            return found, [], None
        heard = hear_cameras(depths, airborne, found.enu_from_level, options.place, rng=rng)
        return found, heard, walls_picture(depths, airborne, found.enu_from_level, options.place)

    registration, witnesses, picture = job.store.stage(
        f"{name}.register",
        compute,
        options=(options.place, job.seed),
        after=["walls", f"{name}.depths"],
        code=[skymoor.facade, skymoor.ground, skymoor.match, skymoor.register, skymoor.geometry],
    )
    return Placed(
        name,
        level,
        level_from_sfm,
        registration,
        gravity,
        depths,
        base=bases[0],
        walls=picture,
        witnesses=tuple(witnesses),
    )
