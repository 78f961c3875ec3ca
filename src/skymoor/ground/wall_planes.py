# SPDX-License-Identifier: Apache-2.0
"""Vertical planes of a levelled model.

In plan a wall is a line of points above each other. Points with horizontal normals are gathered in cells
of the plan, weighted by how many heights each holds; then the best lines are taken one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Similarity
from skymoor.ground.surface import Surface
from skymoor.types import Array

Index = NDArray[np.intp]

SEEDS = 64
SECTORS = 8
FEWEST_CELLS = 5


@dataclass(frozen=True)
class WallOptions:
    """What counts as a wall.

    Attributes:
        cell_m: edge of the cells in which points are gathered.
        min_points: points that a cell of space needs.
        max_normal_up: largest vertical component of the unit normal of a point of a wall.
        thickness_m: largest distance of a wall's point from its plane.
        angle_deg: largest angle between the normals of a wall and of its points.
        gap_m: two pieces further apart than this are two walls.
        min_length_m, min_height_m, min_area_m2: smaller walls are dropped; the area is the observed one.
        min_levels: heights, in cells, that a cell of the plan needs to be part of a wall.
        max_walls: the largest ones are kept.
    """

    cell_m: float = 0.35
    min_points: int = 2
    max_normal_up: float = 0.35
    thickness_m: float = 0.3
    angle_deg: float = 20.0
    gap_m: float = 2.5
    min_length_m: float = 2.0
    min_height_m: float = 1.5
    min_area_m2: float = 8.0
    min_levels: int = 3
    max_walls: int = 150


@dataclass(frozen=True, eq=False)
class Wall:
    """The part s0..s1, z0..z1 of the vertical plane normal @ (x, y) = offset.

    `normal` (2,) points outwards; `right` is to the right as seen from outside, and s is measured along it.
    `area_m2` is the observed area.
    """

    normal: Array
    offset: float
    s0: float
    s1: float
    z0: float
    z1: float
    area_m2: float

    @cached_property
    def right(self) -> Array:
        """Unit vector (2,) along the wall."""
        return np.array([-self.normal[1], self.normal[0]])

    def point(self, s: float, z: float) -> Array:
        """The point (3,) of the plane at s along the wall and height z."""
        return np.array([*(self.normal * self.offset + self.right * s), z])

    @cached_property
    def centre(self) -> Array:
        """Middle of the rectangle, (3,)."""
        return self.point((self.s0 + self.s1) / 2, (self.z0 + self.z1) / 2)

    @cached_property
    def corners(self) -> Array:
        """The four corners, (4, 3)."""
        return np.array([self.point(s, z) for s in (self.s0, self.s1) for z in (self.z0, self.z1)])


def transformed_wall(wall: Wall, target_from_source: Similarity) -> Wall:
    """The wall in another levelled frame; a tilt of the similarity is ignored."""
    corners = target_from_source.apply(wall.corners)
    direction = target_from_source.rotation[:2, :2] @ wall.normal
    normal = direction / np.linalg.norm(direction)
    right = np.array([-normal[1], normal[0]])
    s, z = corners[:, :2] @ right, corners[:, 2]
    return replace(
        wall,
        normal=normal,
        offset=float(np.mean(corners[:, :2] @ normal)),
        s0=float(s.min()),
        s1=float(s.max()),
        z0=float(z.min()),
        z1=float(z.max()),
        area_m2=wall.area_m2 * target_from_source.scale**2,
    )


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of the plan: position (n, 2), normal (n, 2), heights that they hold (n,), and the voxels behind them."""

    xy: Array
    normal: Array
    levels: Array
    voxel_xyz: Array
    voxel_cell: Index


def find_walls(surface: Surface, options: WallOptions | None = None, *, rng: np.random.Generator) -> list[Wall]:
    """Walls of a levelled surface in metres, the largest first; an empty list where it has none.

    Greedy: of some random cells the one with most others on its line is taken, the line is fitted to what is
    connected, and its cells are removed.
    """
    options = options or WallOptions()
    cells = _gather(surface.take(np.abs(surface.normals[:, 2]) < options.max_normal_up), options)
    left, walls, failures = np.arange(len(cells.xy)), [], 0
    while len(left) >= FEWEST_CELLS and failures < SEEDS:
        seed = _best_seed(cells, left, options, rng)
        found = _grow(cells, left, seed, options)
        wall = None if found is None else _measure(cells, *found, options)
        if found is None or wall is None:
            failures += 1
            left = left[left != seed]
            continue
        walls.append(wall)
        failures = 0
        left = np.setdiff1d(left, _explained(cells, left, wall, options), assume_unique=True)
    return sorted(walls, key=lambda wall: -wall.area_m2)[: options.max_walls]


def _gather(surface: Surface, options: WallOptions) -> _Cells:
    # The direction of the normal is part of the key, so that the two sides of a thin wall and of a corner stay apart.
    angle = np.arctan2(surface.normals[:, 1], surface.normals[:, 0])
    sector = np.floor((angle + np.pi) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    key = np.column_stack([np.floor(surface.xyz / options.cell_m).astype(np.int64), sector])
    voxels, of_voxel, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    sums = _sums(np.column_stack([surface.xyz, surface.normals[:, :2]]).astype(np.float64), of_voxel, len(voxels))
    full = counts >= options.min_points
    means, voxels = sums[full] / counts[full, None], voxels[full]
    plan, of_cell, levels = np.unique(voxels[:, [0, 1, 3]], axis=0, return_inverse=True, return_counts=True)
    of_cell = of_cell.ravel()
    tall = levels >= options.min_levels
    sums = _sums(means, of_cell, len(plan)) / np.maximum(levels, 1)[:, None]
    normal = sums[tall, 3:] / (np.linalg.norm(sums[tall, 3:], axis=1, keepdims=True) + 1e-12)
    renumbered = np.where(tall, np.cumsum(tall) - 1, -1)[of_cell]
    kept = renumbered >= 0
    return _Cells(sums[tall, :2], normal, levels[tall].astype(np.float64), means[kept, :3], renumbered[kept])


def _sums(values: Array, index: Index, count: int) -> Array:
    return np.column_stack([np.bincount(index.ravel(), column, minlength=count) for column in values.T])


def _best_seed(cells: _Cells, left: Index, options: WallOptions, rng: np.random.Generator) -> int:
    pick = left[rng.integers(0, len(left), SEEDS)]
    apart = cells.xy[left] - cells.xy[pick, None]
    normal = cells.normal[pick, None]
    off = np.abs(apart[..., 0] * normal[..., 0] + apart[..., 1] * normal[..., 1])
    along = np.abs(apart[..., 1] * normal[..., 0] - apart[..., 0] * normal[..., 1])
    parallel = cells.normal[pick] @ cells.normal[left].T > np.cos(np.radians(options.angle_deg))
    # Far along the line the normal of the seed, good to some degrees only, is no constraint.
    support = ((off < options.thickness_m) & (along < 8.0) & parallel) @ cells.levels[left]
    return int(pick[np.argmax(support)])


def _grow(cells: _Cells, left: Index, seed: int, options: WallOptions) -> tuple[Index, Array] | None:
    """Cells connected with the seed on one line, and the line's normal."""
    normal, centre, cosine = cells.normal[seed], cells.xy[seed], np.cos(np.radians(options.angle_deg))
    xy, normals = cells.xy[left], cells.normal[left]
    members: Index = np.zeros(0, np.intp)
    for _ in range(4):
        near = np.flatnonzero((np.abs((xy - centre) @ normal) < options.thickness_m) & (normals @ normal > cosine))
        if len(near) < FEWEST_CELLS:
            return None
        along = (xy[near] - centre) @ [-normal[1], normal[0]]
        order = np.argsort(along)
        piece = np.concatenate([[0], np.cumsum(np.diff(along[order]) > options.gap_m)])
        members = near[order[piece == piece[np.argmin(np.abs(along[order]))]]]
        if len(members) < FEWEST_CELLS:
            return None
        weights = cells.levels[left[members]]
        centre = np.average(xy[members], axis=0, weights=weights)
        arms = (xy[members] - centre) * np.sqrt(weights)[:, None]
        fitted = np.linalg.eigh(arms.T @ arms)[1][:, 0]
        fitted = fitted if fitted @ normal > 0 else -fitted
        if fitted @ cells.normal[seed] < np.cos(np.radians(1.25 * options.angle_deg)):
            return None
        normal = fitted
    return left[members], normal


def _measure(cells: _Cells, members: Index, normal: Array, options: WallOptions) -> Wall | None:
    xyz = cells.voxel_xyz[np.isin(cells.voxel_cell, members)]
    offset = float(np.median(xyz[:, :2] @ normal))
    s0, s1 = np.percentile(xyz[:, :2] @ [-normal[1], normal[0]], [1, 99])
    z0, z1 = np.percentile(xyz[:, 2], [1, 99])
    area = len(xyz) * options.cell_m**2
    if s1 - s0 < options.min_length_m or z1 - z0 < options.min_height_m or area < options.min_area_m2:
        return None
    return Wall(normal, offset, float(s0), float(s1), float(z0), float(z1), float(area))


def _explained(cells: _Cells, left: Index, wall: Wall, options: WallOptions) -> Index:
    """Cells that belong to a wall found, with a margin, so that its roughness is not found again as a wall."""
    xy = cells.xy[left]
    along = xy @ wall.right
    inside = (along >= wall.s0 - options.thickness_m) & (along <= wall.s1 + options.thickness_m)
    near = np.abs(xy @ wall.normal - wall.offset) < 2.5 * options.thickness_m
    parallel = cells.normal[left] @ wall.normal > np.cos(np.radians(2 * options.angle_deg))
    explained: Index = left[inside & near & parallel]
    return explained
