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
from skymoor.ground.walls.facades import Facade, FacadeOptions, facade_from
from skymoor.ground.walls.visibility import HeightRaster
from skymoor.types import Array, DepthMap, Raster

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
    # The options are in metres, `facade_from` takes lengths in the unit of the photos' frame, here level units.
    level_per_m = level_from_enu.scale
    in_level = FacadeOptions(
        tolerance_m=options.tolerance_m * level_per_m,
        margin_m=options.margin_m * level_per_m,
        no_depth_margin_m=options.margin_m * level_per_m,
        photos=options.photos,
        blend=options.blend,
    )
    if not facades or not maps_level:
        return []
    quality = _quality(facades, maps_level, enu_from_level, heights, options)
    found = []
    for facade, of_photos in zip(facades, quality, strict=True):
        finest = np.argsort(-of_photos, kind="stable")[: options.photos]
        seeing = [maps_level[i] for i in finest if of_photos[i] > 0]
        if not seeing:
            continue
        wall = transformed_wall(facade.wall, level_from_enu)
        orthophoto = facade_from(wall, seeing, facade.pixel_m * level_per_m, in_level)
        if orthophoto.raster.mask.sum() >= FEWEST_PX:
            found.append(_on_grid(orthophoto, facade, options))
    return found


def _quality(
    facades: Sequence[Facade],
    maps_level: Sequence[DepthMap],
    enu_from_level: Similarity,
    heights: HeightRaster,
    options: FacadePairOptions,
) -> Array:
    """Pixels per metre (f, n) of photos on walls; zero where a photo does not see any of a wall.

    It does when it is in front of the wall, near enough, with some of the wall in its frame and a free line of sight.
    """
    cameras = [one.camera for one in maps_level]
    lenses = np.array([[c.intrinsics.fx, c.intrinsics.fy, c.intrinsics.cx, c.intrinsics.cy] for c in cameras])
    sizes = np.array([[c.intrinsics.width, c.intrinsics.height] for c in cameras])
    axes = np.array([c.cam_from_world.rotation for c in cameras]) @ enu_from_level.rotation.T
    centres = enu_from_level.apply(np.array([c.centre for c in cameras]))
    walls = [facade.wall for facade in facades]
    targets = np.array([[*wall.corners, wall.centre] for wall in walls])  # (f, 5, 3)
    normals, offsets = np.array([wall.normal for wall in walls]), np.array([wall.offset for wall in walls])
    before = normals @ centres[:, :2].T - offsets[:, None]  # (f, n)
    arms = targets[:, None] - centres[None, :, None]  # (f, n, 5, 3)
    distance = np.maximum(np.linalg.norm(arms, axis=3), 1e-9)
    seeing = (distance[..., 4] < options.max_distance_m) & (before > options.min_cosine * distance[..., 4])
    rays = np.einsum("nij,fnkj->fnki", axes, arms)
    px = rays[..., :2] / np.maximum(rays[..., 2:], 1e-6) * lenses[None, :, None, :2] + lenses[None, :, None, 2:]
    ahead = rays[..., 2] > 0
    # A long wall may cross the image with all its corners outside: the box around them decides.
    outside = (px.max(axis=2) < 0).any(axis=2) | (px.min(axis=2) > sizes).any(axis=2)
    seeing &= ahead.any(axis=2) & ~(ahead.all(axis=2) & outside)
    fineness = np.median(before[..., None] / distance**2, axis=2) * lenses[:, 0]
    which, who = np.nonzero(seeing)
    # Half a metre in front of the wall: cells of the height raster extend over its edge.
    ends = targets[which, 4] + 0.5 * np.column_stack([normals[which], np.zeros(len(which))])
    line_of_sight = centres[who] + np.linspace(0.05, 0.9, 16)[:, None, None] * (ends - centres[who])
    surface = heights.at(line_of_sight[..., :2], only_seen=True)
    free = ~(line_of_sight[..., 2] < surface - options.clearance_m).any(axis=0)
    quality = np.zeros(seeing.shape)
    quality[which[free], who[free]] = fineness[which[free], who[free]]
    return quality


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
