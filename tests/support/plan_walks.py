# SPDX-License-Identifier: Apache-2.0
"""A walk round a house in a frame of its own, and the site of that house from above."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.geo import Grid
from skymoor.geometry import Similarity
from skymoor.ground.plan_view import PlanModel, PlanTarget, plan_model, plan_target
from skymoor.ground.walls import transformed_depth_map
from support.houses import Houses, site_with_an_l, walk_round_the_l

EYE_M = 1.75
TURN_DEG = 131.0
GRID = Grid(-50.0, 50.0, 0.75, (133, 133))


def floated() -> Similarity:
    """enu_from_level of a level frame whose unit is the cameras' height, turned by an odd angle."""
    rotation = Rotation.from_euler("z", TURN_DEG, degrees=True).as_matrix()
    return Similarity(1 / EYE_M, rotation, np.array([40.0, -7.0, 0.0])).inverse()


@lru_cache(maxsize=1)
def walked_l() -> PlanModel:
    """The walk round the house of `site_with_an_l`, in the frame of `floated`."""
    level_from_enu = floated().inverse()
    maps = [transformed_depth_map(one, level_from_enu) for one in walk_round_the_l(site_with_an_l())]
    return plan_model(maps, rng=np.random.default_rng(0))


def from_above(world: Houses) -> PlanTarget:
    """The exact heights of a site in plan."""
    return plan_target(world.tops(GRID.centres()).astype(np.float32), GRID)


def without(world: Houses, removed: Sequence[int]) -> Houses:
    """A site without some of its boxes."""
    kept = np.setdiff1d(np.arange(len(world.middle)), removed)
    return Houses(world.middle[kept], world.half[kept], world.height[kept], world.heading_deg[kept], world.seed)


def open_ground(rough_m: float) -> PlanTarget:
    """A site without houses."""
    up = np.random.default_rng(0).normal(scale=rough_m, size=GRID.shape) if rough_m else np.zeros(GRID.shape)
    return plan_target(up.astype(np.float32), GRID)


def camera_gaps(model: PlanModel, a: Similarity, b: Similarity) -> NDArray[np.float64]:
    """Distances in plan (n,) of the cameras under two similarities."""
    return np.asarray(np.linalg.norm((a.apply(model.cameras) - b.apply(model.cameras))[:, :2], axis=1))
