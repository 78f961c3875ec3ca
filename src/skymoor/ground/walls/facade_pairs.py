# SPDX-License-Identifier: Apache-2.0
"""Orthophotos of airborne walls from ground photos, under a hypothesis of the registration.

Every photo contributes to every wall that it should see, also where the model of the photos has no depth: a wrong
hypothesis has to explain them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.wall_planes import transformed_wall
from skymoor.ground.walls.facades import Facade, FacadeOptions, facade_of
from skymoor.ground.walls.visibility import HeightRaster
from skymoor.types import Array, DepthMap, Mask, Raster

FEWEST_PX = 100


@dataclass(frozen=True)
class FacadePairOptions:
    """Which photos are compared with which walls.

    Attributes:
        max_distance_m: walls further from a camera than this are not compared.
        min_cosine: of the angle between the wall's normal and the direction to the camera.
        margin_m: by how much the orthophoto of a wall exceeds the wall.
        tolerance_m: a photo whose depth is further than this from the wall does not show the wall.
        clearance_m: a line of sight may pass this far below the surface seen from above.
        photos, blend: see `FacadeOptions`.
    """

    max_distance_m: float = 60.0
    min_cosine: float = 0.2
    margin_m: float = 1.0
    tolerance_m: float = 0.6
    clearance_m: float = 1.0
    photos: int = 4
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
    heights: HeightRaster,
    maps_level: Sequence[DepthMap],
    enu_from_level: Similarity,
    options: FacadePairOptions | None = None,
) -> list[FacadePair]:
    """Orthophotos from the photos (level) of each of the facades (ENU) that they should see.

    A photo without any depth is used as well: it is assumed to show whatever nothing is known to hide.
    """
    options = options or FacadePairOptions()
    level_from_enu = enu_from_level.inverse()
    # The options are in metres, `facade_of` takes lengths in the unit of the photos' frame, here level units.
    level_per_m = level_from_enu.scale
    in_level = FacadeOptions(
        tolerance_m=options.tolerance_m * level_per_m,
        margin_m=options.margin_m * level_per_m,
        no_depth_margin_m=options.margin_m * level_per_m,
        photos=options.photos,
        blend=options.blend,
    )
    centres = enu_from_level.apply(np.array([m.camera.centre for m in maps_level]).reshape(-1, 3))
    found = []
    for facade in facades:
        seeing = np.flatnonzero(_seeing(facade, centres, heights, options)).tolist()
        if not seeing:
            continue
        wall = transformed_wall(facade.wall, level_from_enu)
        orthophoto = facade_of(wall, [maps_level[i] for i in seeing], facade.pixel_m * level_per_m, in_level)
        if orthophoto.raster.mask.sum() >= FEWEST_PX:
            found.append(_on_grid(orthophoto, facade, options))
    return found


def _seeing(facade: Facade, centres: Array, heights: HeightRaster, options: FacadePairOptions) -> Mask:
    """Which cameras (n, 3) are in front of the wall, near enough, and with a free line of sight."""
    wall = facade.wall
    distance = np.linalg.norm(centres - wall.centre, axis=1)
    cosine = (centres[:, :2] @ wall.normal - wall.offset) / np.maximum(distance, 1e-9)
    seeing: Mask = (distance < options.max_distance_m) & (cosine > options.min_cosine)
    if not seeing.any():
        return seeing
    # Half a metre in front of the wall: cells of the height raster extend over its edge.
    target = wall.centre + 0.5 * np.array([*wall.normal, 0.0])
    line_of_sight = centres + np.linspace(0.05, 0.9, 16)[:, None, None] * (target - centres)
    below = line_of_sight[..., 2] < heights.at(line_of_sight[..., :2], only_seen=True) - options.clearance_m
    return np.asarray(seeing & ~below.any(axis=0))


def _on_grid(own: Facade, facade: Facade, options: FacadePairOptions) -> FacadePair:
    """Both orthophotos cut to the pixels that they share; they differ by the margins only."""
    du = round((facade.wall.s0 - options.margin_m - facade.s0) / facade.pixel_m)
    dv = round((facade.z1 - facade.wall.z1 - options.margin_m) / facade.pixel_m)
    u0, v0 = max(du, 0), max(dv, 0)
    height = min(facade.raster.mask.shape[0] - v0, own.raster.mask.shape[0] - (v0 - dv))
    width = min(facade.raster.mask.shape[1] - u0, own.raster.mask.shape[1] - (u0 - du))
    of_airborne = (slice(v0, v0 + height), slice(u0, u0 + width))
    of_ground = (slice(v0 - dv, v0 - dv + height), slice(u0 - du, u0 - du + width))
    return FacadePair(
        facade,
        Raster(own.raster.rgb[of_ground], own.raster.mask[of_ground]),
        Raster(facade.raster.rgb[of_airborne], facade.raster.mask[of_airborne]),
        np.array([u0, v0], dtype=np.float64),
    )
