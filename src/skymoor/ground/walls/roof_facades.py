# SPDX-License-Identifier: Apache-2.0
"""Orthophotos of walls below roof edges, from all photos that see them, and the walls' planes from these photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from skymoor.ground.wall_planes import Wall
from skymoor.ground.walls.facades import Facade, FacadeOptions, Hidden, facade_of
from skymoor.ground.walls.visibility import HeightRaster
from skymoor.types import Array, Array32, Camera, DepthMap, Image, Mask

FRONT_M = 1.5  # before a wall, where the heights of its own roof and eaves are not taken for something that hides it
CLEAR_M = 0.5  # by which a line of sight may pass below the surface: cells of heights extend over edges
STEPS_M = np.arange(FRONT_M, 30.0, 0.75)
COARSE_PX = 4  # visibility is computed at every such pixel


@dataclass(frozen=True)
class RoofFacadeOptions:
    """Which photos show a wall, and how its plane is found.

    Attributes:
        min_cosine: of the angle between ray and normal of the wall: flatter views show nothing; sin 10 degrees.
        max_detail_m: of the photos' pixels, upwards on the wall; walls with coarser pictures are dropped.
        min_seen_m2: area of a wall that must be seen.
        offsets_m, offset_step_m: reach and spacing of the plane's positions that are tried along its normal.
        min_parallax: by how much the tangents of two photos' elevations must differ for the wall's plane to be moved.
    """

    min_cosine: float = 0.17
    max_detail_m: float = 0.8
    min_seen_m2: float = 8.0
    offsets_m: float = 1.5
    offset_step_m: float = 0.15
    min_parallax: float = 0.3


def roof_facades(
    walls: Sequence[Wall],
    maps: Sequence[DepthMap],
    heights: HeightRaster,
    pixel_m: float,
    options: RoofFacadeOptions | None = None,
) -> list[Facade]:
    """Orthophotos of the walls that the photos show well enough; all in ENU metres.

    `heights`, of the surface seen from above, tell what hides a wall: where photos are near-vertical, depths on walls
    are interpolated from roof and ground.
    """
    options = options or RoofFacadeOptions()
    choices = FacadeOptions(min_cosine=options.min_cosine, margin_m=0.5)
    found = []
    for wall in walls:
        hidden = _hidden_by(heights, wall)
        placed = _on_photos(wall, maps, pixel_m, hidden, options)
        facade = facade_of(placed, maps, pixel_m, choices, hidden=hidden)
        seen_m2 = float(facade.raster.mask.sum()) * facade.pixel_m**2
        if seen_m2 >= options.min_seen_m2 and facade.detail_m[1] <= options.max_detail_m:
            found.append(facade)
    return found


def _hidden_by(heights: HeightRaster, wall: Wall) -> Hidden:
    """Whether the surface seen from above lies between a point of the wall and a camera."""
    normal = np.array([*wall.normal, 0.0])

    def hidden(camera: Camera, xyz: Array) -> Mask:
        coarse = xyz[::COARSE_PX, ::COARSE_PX]
        ray = camera.centre - coarse
        before = np.maximum(ray @ normal, 1e-6)
        blocked = np.zeros(coarse.shape[:2], bool)
        for step in STEPS_M:
            point = coarse + ray * (step / before)[..., None]
            with np.errstate(invalid="ignore"):
                blocked |= (before > step) & (point[..., 2] < heights.at(point[..., :2], only_seen=True) - CLEAR_M)
        size = (xyz.shape[1], xyz.shape[0])
        return np.asarray(cv2.resize(blocked.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)

    return hidden


def _on_photos(
    wall: Wall, maps: Sequence[DepthMap], pixel_m: float, hidden: Hidden, options: RoofFacadeOptions
) -> Wall:
    """The wall moved along its normal to where the two photos that show it best agree.

    Two photos under elevations a and b shift against each other by tan(a) - tan(b) metres per metre of the wall's
    position. Without such photos, or where they agree nowhere in particular, it stays.
    """
    seeing = _photos_of(wall, maps, options)
    pairs = [(a, b) for k, a in enumerate(seeing) for b in seeing[:k] if abs(a[0] - b[0]) >= options.min_parallax]
    if not pairs:
        return wall
    (_, first), (_, second) = pairs[0]
    choices = FacadeOptions(min_cosine=options.min_cosine, margin_m=0.0)
    offsets = np.arange(-options.offsets_m, options.offsets_m + 1e-6, options.offset_step_m)
    scores = np.full(len(offsets), np.nan)
    for k, offset in enumerate(offsets):
        moved = replace(wall, offset=wall.offset + float(offset))
        a, b = (facade_of(moved, [one], pixel_m, choices, hidden=hidden).raster for one in (first, second))
        scores[k] = _likeness(a.rgb, b.rgb, a.mask & b.mask)
    if not np.isfinite(scores).all():
        return wall
    best = int(np.argmax(scores))
    inner = 0 < best < len(scores) - 1
    return replace(wall, offset=wall.offset + float(offsets[best])) if inner and _is_peak(scores, best) else wall


def _photos_of(wall: Wall, maps: Sequence[DepthMap], options: RoofFacadeOptions) -> list[tuple[float, DepthMap]]:
    """Photos in front of a wall with the tangents of their elevations from it, those of the finest detail first."""
    found = []
    for depth_map in maps:
        ray = depth_map.camera.centre - wall.centre
        before, distance = float(ray[:2] @ wall.normal), float(np.linalg.norm(ray))
        i = depth_map.camera.intrinsics
        xyz = depth_map.camera.cam_from_world.apply(wall.centre[None])[0]
        u, v = xyz[:2] / max(xyz[2], 1e-6) * [i.fx, i.fy] + [i.cx, i.cy]
        if before / distance > options.min_cosine and xyz[2] > 0 and 0 < u < i.width and 0 < v < i.height:
            found.append((before / distance * i.fx / distance, float(ray[2]) / before, depth_map))
    return [(tangent, one) for _, tangent, one in sorted(found, key=lambda item: -item[0])]


def _likeness(a: Image, b: Image, both: Mask) -> float:
    """Correlation of the vertical gradients of two pictures (h, w, 3), where both are known; NaN for too few pixels."""
    if both.sum() < 200:
        return float("nan")
    x, y = (_vertical_gradient(rgb) for rgb in (a, b))
    inner = cv2.erode(both.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    if inner.sum() < 100:
        return float("nan")
    return float(np.corrcoef(x[inner], y[inner])[0, 1])


def _vertical_gradient(rgb: Image) -> Array32:
    smooth = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), 1.5)
    return np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1), dtype=np.float32)


def _is_peak(scores: Array, best: int) -> bool:
    """Whether the best of the scores stands out from their scatter."""
    rest = np.delete(scores, slice(max(best - 2, 0), best + 3))
    return bool(scores[best] > 0.4 and scores[best] > np.median(rest) + 2.0 * np.std(rest))
