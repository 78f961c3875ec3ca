# SPDX-License-Identifier: Apache-2.0
"""Free space: ground photos look from above the ground, and not through buildings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from skymoor.errors import DegenerateGeometry
from skymoor.facade.surface import Surface
from skymoor.geometry.similarity import Similarity
from skymoor.types import Array, Array32, DepthMap, Mask


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights of what is seen from above, in cells of the plan: element (row, column) is y0 + row, x0 + column cells.

    Cells that nothing was seen in have the height of the nearest one, and `seen` false.
    """

    height: Array32
    seen: Mask
    x0: float
    y0: float
    cell_m: float

    def at(self, xy: Array, *, only_seen: bool = False) -> Array:
        """Heights (...,) at plan positions (..., 2); NaN outside, and where nothing was seen with `only_seen`."""
        column = np.floor((xy[..., 0] - self.x0) / self.cell_m).astype(np.int64)
        row = np.floor((xy[..., 1] - self.y0) / self.cell_m).astype(np.int64)
        h, w = self.height.shape
        inside = (row >= 0) & (column >= 0) & (row < h) & (column < w)
        row, column = np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)
        if only_seen:
            inside &= self.seen[row, column]
        return np.where(inside, self.height[row, column], np.nan)


@dataclass(frozen=True, eq=False)
class Sight:
    """Viewing rays of a model: cameras (n, 3), and places (n, rays, steps, 3) on the way to what each one sees."""

    centres: Array
    ways: Array


def relief_of(surface: Surface, *, cell_m: float = 1.0, min_normal_up: float = 0.8) -> Relief:
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
    return Relief(height[rows, columns], known, float(x0), float(y0), cell_m)


def sight_of(maps: Sequence[DepthMap], *, rays: int = 40, steps: int = 12, rng: np.random.Generator) -> Sight:
    """Some viewing rays of each photo, up to shortly before what it sees."""
    centres, ways = [], []
    for depth_map in maps:
        rows, columns = np.nonzero(np.isfinite(depth_map.depth))
        if not len(rows):
            continue
        pick = rng.integers(0, len(rows), rays)
        z = depth_map.depth[rows[pick], columns[pick]].astype(np.float64)
        px = np.column_stack([columns[pick] + 0.5, rows[pick] + 0.5])
        directions = depth_map.camera.intrinsics.rays(px) @ depth_map.camera.cam_from_world.rotation
        share = np.linspace(0.0, 0.85, steps)
        ways.append(depth_map.camera.centre + (share[:, None] * z[:, None, None]) * directions[:, None])
        centres.append(depth_map.camera.centre)
    return Sight(np.array(centres).reshape(-1, 3), np.array(ways).reshape(-1, rays, steps, 3))


@dataclass(frozen=True)
class SightCheck:
    """How high the cameras stand (median, m), and the share of the rays that cross something by more than a metre."""

    height_m: float
    blocked: float
    outside: float


def check_sight(sight: Sight, enu_from_level: Similarity, relief: Relief, *, margin_m: float = 1.0) -> SightCheck:
    """Where a hypothesis puts the cameras, seen from above. Cameras off the map count in `outside` only."""
    centres = enu_from_level.apply(sight.centres)
    above = centres[:, 2] - relief.at(centres[:, :2])
    ways = enu_from_level.apply(sight.ways)
    below = ways[..., 2] < relief.at(ways[..., :2], only_seen=True) - margin_m
    outside = float(np.isnan(above).mean()) if len(above) else 1.0
    height = float(np.nanmedian(above)) if outside < 1 else float("nan")
    return SightCheck(height, float(below.any(axis=-1).mean()) if below.size else 0.0, outside)
