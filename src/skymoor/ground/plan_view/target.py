# SPDX-License-Identifier: Apache-2.0
"""What a surface seen from above tells of walls and free space: its height steps, and what is raised above ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from skymoor.geo import Grid
from skymoor.ground.plan_view.ground_colour import ColourMap, halved
from skymoor.ground.wall_planes import Wall
from skymoor.registration import ground_level
from skymoor.registration.bare_earth import RAISED_M
from skymoor.types import Array, Array32, Mask

LARGEST_HOLE_M2 = 400.0  # in a roof
SATURATION = 0.25  # largest step of a cell: a high and straight edge does not outweigh all others
STEP_M = 4.0  # heights above ground are compared up to this: higher walls are not better visible from the ground
SMOOTH_CELLS = 1.0


@dataclass(frozen=True, eq=False)
class PlanTarget:
    """Rasters on `grid`, rows going south.

    Attributes:
        steps: (2, h, w) downward slope of the height above ground, towards u and v: on walls their outward normal.
        raised: (h, w) houses and trees, 0 to 1.
        known: (h, w) where there are heights.
        colour: of the orthophoto, if there is one.
    """

    grid: Grid
    steps: Array32
    raised: Array32
    known: Mask
    colour: ColourMap | None = None

    @cached_property
    def steps_and_known(self) -> tuple[Array32, Array32, Array32]:
        """Both layers of steps, and where heights are known, each with a border of one cell of zeros."""
        u, v, known = (np.pad(layer, 1) for layer in (*self.steps, self.known.astype(np.float32)))
        return u, v, known

    @cached_property
    def padded_raised(self) -> Array32:
        """`raised` with the same border."""
        return np.pad(self.raised, 1)

    def halved(self) -> PlanTarget:
        """The same in cells twice as large."""
        shape = ((self.known.shape[0] + 1) // 2, (self.known.shape[1] + 1) // 2)
        grid = Grid(self.grid.east0, self.grid.north0, 2 * self.grid.pixel_m, shape)
        steps = np.stack([halved(step) for step in self.steps])
        known = halved(self.known.astype(np.float32)) >= 0.5
        return PlanTarget(
            grid, steps, halved(self.raised), known, None if self.colour is None else self.colour.halved()
        )


def plan_target(
    up: Array32,
    grid: Grid,
    *,
    seen: Mask | None = None,
    walls: Sequence[Wall] = (),
    colour: ColourMap | None = None,
) -> PlanTarget:
    """Height steps and houses of a surface seen from above.

    Beside a roof the ground is often hidden, and its heights are interpolated: steps are then spread over metres, and
    it seems to be a house. So steps are taken of all heights, of the measured ones alone, and of straight roof edges,
    and what is interpolated does not speak against free space.

    Args:
        up: (h, w) ENU metres, NaN where unknown.
        grid: of them, with pixels of half a metre to a metre.
        seen: (h, w) where heights are measured and not interpolated; by default where they are known.
        walls: whose upper edges are straight steps.
        colour: of the orthophoto on the same grid.
    """
    ground, known = ground_level(up, grid.pixel_m), np.isfinite(up)
    measured = known if seen is None else seen & known
    above = np.where(known, np.nan_to_num(up - ground), 0.0)
    houses = (above > RAISED_M) & measured
    solid = np.where(_without_holes(houses, grid.pixel_m), above, np.where(measured, above, 0.0))
    steps = _slopes(above) + _slopes(solid) + _edges(walls, grid)
    size = np.maximum(np.hypot(*steps), 1e-6)
    steps = steps * np.minimum(1.0, SATURATION / size)
    smooth = cv2.GaussianBlur(houses.astype(np.float32), (0, 0), SMOOTH_CELLS)
    return PlanTarget(grid, steps.astype(np.float32), smooth, known, colour)


def _slopes(above: Array) -> Array32:
    """Downward slope (2, h, w) of heights above ground, per cell and STEP_M."""
    smooth = cv2.GaussianBlur((np.clip(above, 0, STEP_M) / STEP_M).astype(np.float32), (0, 0), SMOOTH_CELLS)
    return -np.stack([cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0)])


def _edges(walls: Sequence[Wall], grid: Grid) -> Array32:
    """Outward normals (2, h, w) of walls, blurred by a cell; the less the lower a wall is."""
    steps = np.zeros((2, *grid.shape), np.float32)
    for wall in walls:
        ends = grid.px_from_enu(np.array([wall.point(s, 0.0)[:2] for s in (wall.s0, wall.s1)]))
        line = np.zeros(grid.shape, np.float32)
        first, last = (tuple(int(x) for x in end) for end in ends)
        cv2.line(line, first, last, min((wall.z1 - wall.z0) / STEP_M, 1.0), 1)
        normal = np.array([wall.normal[0], -wall.normal[1]], np.float32)
        steps += cv2.GaussianBlur(line, (0, 0), SMOOTH_CELLS) * normal[:, None, None]
    return steps


def _without_holes(houses: Mask, cell_m: float) -> Mask:
    """Houses (h, w) with what they enclose: plain roofs are measured in part."""
    closed = cv2.morphologyEx(houses.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~closed).astype(np.uint8), connectivity=4)
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    small = stats[:, cv2.CC_STAT_AREA] * cell_m**2 < LARGEST_HOLE_M2
    small[border] = False
    return np.asarray(closed | small[labels])
