# SPDX-License-Identifier: Apache-2.0
"""How the photos of one model show the walls of another, if the two lie as a hypothesis says.

This asks every photo about every wall that it should see, also where the photos' own model has no depth: a wrong
hypothesis has to explain them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.walls.facades import Facade, FacadeOptions, facade_of
from skymoor.ground.walls.visibility import HeightRaster
from skymoor.ground.walls.walls import transformed_wall
from skymoor.types import Array, DepthMap, Mask, Raster

FEWEST_PX = 100


@dataclass(frozen=True)
class FacadePairOptions:
    """Which photos are asked about which walls.

    Attributes:
        reach_m: walls further from a camera than this are not asked about.
        min_cosine: of the angle between the wall's normal and the direction to the camera.
        margin_m: by how much a wall's picture exceeds the wall.
        tolerance_m: a photo whose depth is further than this from the wall shows something else.
        clearance_m: a line of sight may dip this far under what is seen from above.
        photos, blend: see `FacadeOptions`.
    """

    reach_m: float = 60.0
    min_cosine: float = 0.2
    margin_m: float = 1.0
    tolerance_m: float = 0.6
    clearance_m: float = 1.0
    photos: int = 6
    blend: int = 2


@dataclass(frozen=True, eq=False)
class FacadePair:
    """The orthophoto of an airborne wall from ground photos, `ground`, and from airborne ones, `airborne`, on one grid.

    `offset_px` (2,) is added to a pixel of the grid for the pixel of the facade.
    """

    facade: Facade
    ground: Raster
    airborne: Raster
    offset_px: Array


def pair_facades(
    facades: Sequence[Facade],
    relief: HeightRaster,
    maps_level: Sequence[DepthMap],
    enu_from_level: Similarity,
    options: FacadePairOptions | None = None,
) -> list[FacadePair]:
    """How the photos (level) show each of the facades (ENU) that they should see.

    A photo without any depth may be asked too: it is taken to show whatever nothing is known to hide.
    """
    options = options or FacadePairOptions()
    level_from_enu = enu_from_level.inverse()
    unit = level_from_enu.scale
    how = FacadeOptions(
        tolerance_m=options.tolerance_m * unit,
        margin_m=options.margin_m * unit,
        guess_margin_m=options.margin_m * unit,
        photos=options.photos,
        blend=options.blend,
    )
    centres = enu_from_level.apply(np.array([m.camera.centre for m in maps_level]).reshape(-1, 3))
    found = []
    for facade in facades:
        seeing = np.flatnonzero(_seeing(facade, centres, relief, options)).tolist()
        if not seeing:
            continue
        wall = transformed_wall(facade.wall, level_from_enu)
        near = facade_of(wall, [maps_level[i] for i in seeing], facade.pixel_m * unit, how)
        if near.raster.mask.sum() >= FEWEST_PX:
            found.append(_on_grid(near, facade, options))
    return found


def _seeing(facade: Facade, centres: Array, relief: HeightRaster, options: FacadePairOptions) -> Mask:
    """Which cameras (n, 3) look at the wall from in front, near enough, and over nothing that is in the way."""
    wall = facade.wall
    distance = np.linalg.norm(centres - wall.centre, axis=1)
    cosine = (centres[:, :2] @ wall.normal - wall.offset) / np.maximum(distance, 1e-9)
    # Half a metre before the wall: the relief's cells reach over its edge.
    target = wall.centre + 0.5 * np.array([*wall.normal, 0.0])
    way = centres + np.linspace(0.05, 0.9, 16)[:, None, None] * (target - centres)
    blocked = (way[..., 2] < relief.at(way[..., :2], only_seen=True) - options.clearance_m).any(axis=0)
    seeing: Mask = (distance < options.reach_m) & (cosine > options.min_cosine) & ~blocked
    return seeing


def _on_grid(near: Facade, facade: Facade, options: FacadePairOptions) -> FacadePair:
    """Both pictures cut to the pixels that they share; they differ by the margins only."""
    du = round((facade.wall.s0 - options.margin_m - facade.s0) / facade.pixel_m)
    dv = round((facade.z1 - facade.wall.z1 - options.margin_m) / facade.pixel_m)
    u0, v0 = max(du, 0), max(dv, 0)
    height = min(facade.raster.mask.shape[0] - v0, near.raster.mask.shape[0] - (v0 - dv))
    width = min(facade.raster.mask.shape[1] - u0, near.raster.mask.shape[1] - (u0 - du))
    own = (slice(v0, v0 + height), slice(u0, u0 + width))
    other = (slice(v0 - dv, v0 - dv + height), slice(u0 - du, u0 - du + width))
    return FacadePair(
        facade,
        Raster(near.raster.rgb[other], near.raster.mask[other]),
        Raster(facade.raster.rgb[own], facade.raster.mask[own]),
        np.array([u0, v0], dtype=np.float64),
    )
