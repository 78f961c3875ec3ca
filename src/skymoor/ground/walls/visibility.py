# SPDX-License-Identifier: Apache-2.0
"""Visibility: ground cameras are above the ground, and their viewing rays do not cross walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.surface import Surface
from skymoor.ground.wall_planes import Wall
from skymoor.registration import ground_level
from skymoor.types import Array, Array32, DepthMap, Mask

RAY_SHARE = 0.85
"""Of the length of a viewing ray that is checked: depths and scales are not exact."""

FOOT_M = 1.0
"""Walls are extended downwards by this much below their lowest observed part."""


@dataclass(frozen=True, eq=False)
class HeightRaster:
    """Heights of surfaces seen from above, in cells of the plan: element (row, column) is y0 + row, x0 + column cells.

    Cells without an observation have the height of the nearest one, and `seen` false. `ground` is the height of the
    ground under houses and trees.
    """

    height: Array32
    ground: Array32
    seen: Mask
    x0: float
    y0: float
    cell_m: float

    def at(self, xy: Array, *, only_seen: bool = False) -> Array:
        """Heights (...,) at plan positions (..., 2); NaN outside, and without an observation with `only_seen`."""
        return self._at(self.height, xy, only_seen=only_seen)

    def ground_at(self, xy: Array) -> Array:
        """Heights (...,) of the ground at plan positions (..., 2); NaN outside."""
        return self._at(self.ground, xy, only_seen=False)

    def _at(self, values: Array32, xy: Array, *, only_seen: bool) -> Array:
        column = np.floor((xy[..., 0] - self.x0) / self.cell_m).astype(np.int64)
        row = np.floor((xy[..., 1] - self.y0) / self.cell_m).astype(np.int64)
        h, w = self.height.shape
        inside = (row >= 0) & (column >= 0) & (row < h) & (column < w)
        row, column = np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)
        if only_seen:
            inside &= self.seen[row, column]
        return np.where(inside, values[row, column], np.nan)


@dataclass(frozen=True, eq=False)
class ViewRays:
    """Viewing rays of a model: from camera centres (n, 3) to shortly before the observed surface, (n, rays, 3)."""

    centres: Array
    ends: Array


def height_raster_of(surface: Surface, *, cell_m: float = 1.0, min_normal_up: float = 0.8) -> HeightRaster:
    """Median height of the surfaces that face up, per cell. Raises `DegenerateGeometry` where there are none."""
    flat = surface.xyz[surface.normals[:, 2] > min_normal_up].astype(np.float64)
    if not len(flat):
        raise DegenerateGeometry("the model shows no surface from above")
    x0, y0 = np.floor(flat[:, :2].min(axis=0))
    index = np.floor((flat[:, :2] - [x0, y0]) / cell_m).astype(np.int64)
    w, h = index.max(axis=0) + 1
    cell = index[:, 1] * w + index[:, 0]
    order = np.lexsort((flat[:, 2], cell))
    cells, first, counts = np.unique(cell[order], return_index=True, return_counts=True)
    height = np.full(h * w, np.nan, np.float32)
    height[cells] = flat[order][first + counts // 2, 2]
    height = height.reshape(h, w)
    known = np.isfinite(height)
    rows, columns = distance_transform_edt(~known, return_distances=False, return_indices=True)
    # Cars and people stand on the ground, not on the crowns above it.
    ground = ground_level(height, cell_m)[rows, columns]
    return HeightRaster(height[rows, columns], ground, known, float(x0), float(y0), cell_m)


def view_rays_of(maps: Sequence[DepthMap], *, rays: int = 40, rng: np.random.Generator) -> ViewRays:
    """Some viewing rays of each photo, up to shortly before the observed surface."""
    centres, ends = [], []
    for depth_map in maps:
        rows, columns = np.nonzero(np.isfinite(depth_map.depth))
        if not len(rows):
            continue
        pick = rng.integers(0, len(rows), rays)
        z = depth_map.depth[rows[pick], columns[pick]].astype(np.float64)
        px = np.column_stack([columns[pick] + 0.5, rows[pick] + 0.5])
        directions = depth_map.camera.intrinsics.rays(px) @ depth_map.camera.cam_from_world.rotation
        ends.append(depth_map.camera.centre + RAY_SHARE * z[:, None] * directions)
        centres.append(depth_map.camera.centre)
    return ViewRays(np.array(centres).reshape(-1, 3), np.array(ends).reshape(-1, rays, 3))


@dataclass(frozen=True)
class VisibilityCheck:
    """Height of the cameras above ground (median, m), share of rays that cross walls, and of cameras off the map."""

    height_m: float
    blocked: float
    outside: float


def check_visibility(
    rays: ViewRays, enu_from_level: Similarity, heights: HeightRaster, walls: Sequence[Wall], *, margin_m: float = 0.5
) -> VisibilityCheck:
    """Height and visibility of the cameras under a hypothesis. Cameras off the map count in `outside` only.

    Trees hide from above what is visible below them, so only walls may not be crossed; what is nearer to a wall than
    `margin_m` or to its edge counts as beside it.
    """
    centres = enu_from_level.apply(rays.centres)
    above = centres[:, 2] - heights.ground_at(centres[:, :2])
    outside = float(np.isnan(above).mean()) if len(above) else 1.0
    height = float(np.nanmedian(above)) if outside < 1 else float("nan")
    blocked = _crossed(centres[:, None], enu_from_level.apply(rays.ends), walls, margin_m)
    return VisibilityCheck(height, float(blocked.mean()) if blocked.size else 0.0, outside)


def _crossed(starts: Array, ends: Array, walls: Sequence[Wall], margin_m: float) -> Mask:
    """Which of the rays (n, rays), from (n, 1, 3) to (n, rays, 3), cross a wall."""
    if not walls:
        return np.zeros(ends.shape[:2], bool)
    normals, along = (np.array([getattr(wall, name) for wall in walls]) for name in ("normal", "right"))
    sizes = np.array([[wall.offset, wall.s0 + margin_m, wall.s1 - margin_m, wall.z0, wall.z1] for wall in walls])
    offset, left, right, low, high = sizes.T
    before, behind = (p[..., :2] @ normals.T - offset for p in (starts, ends))  # (n, 1 or rays, walls)
    through = (before * behind < 0) & (np.minimum(np.abs(before), np.abs(behind)) > margin_m)
    share = before / np.where(through, before - behind, 1.0)
    s, t = (p[..., :2] @ along.T for p in (starts, ends))
    s = s + share * (t - s)
    z = starts[..., 2:] + share * (ends - starts)[..., 2:]
    within = (s > left) & (s < right) & (z < high - margin_m) & (z > low - FOOT_M)
    return np.asarray((through & within).any(axis=2))
