# SPDX-License-Identifier: Apache-2.0
"""The agreement in plan of single similarities."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from skymoor.geometry import Similarity
from skymoor.ground.plan_view.ground_colour import GroundCells, moved_cells
from skymoor.ground.plan_view.target import PlanTarget
from skymoor.ground.plan_view.template import PlanModel, PlanPoints
from skymoor.types import Array, Array32, Mask

Whole = NDArray[np.int32]

SCALE_STEP = 1.1  # scales this near have the same distribution of scores
AZIMUTHS = np.radians(np.arange(0.0, 360.0, 60.0)).tolist()
USUAL_PLACES = 150  # of an azimuth, that tell how well a component agrees by chance
MIN_USUAL = 60  # of them and of all azimuths, that must be possible
LEAST_GROUND = -1.5  # another season or parked cars speak against a place only so much


@dataclass(frozen=True)
class ScoreOptions:
    """What is taken off the agreement of a component with a map.

    Attributes:
        usual_height_m, height_sigma: of the cameras, which are one level unit above the ground: log-normal.
        on_map: share of walls and of free space that must lie where heights are known.
        allowed_inside, inside_weight: share of free space within houses that is allowed, and the score that is taken
            off for the rest of it.
    """

    usual_height_m: float = 1.7
    height_sigma: float = 0.5
    on_map: float = 0.7
    allowed_inside: float = 0.02
    inside_weight: float = 15.0

    def penalty(self, inside: Array32, scale: float) -> Array32:
        """For free space in houses, and for an unusual height of the cameras."""
        height = np.log(scale / self.usual_height_m) / self.height_sigma
        return np.asarray(self.inside_weight * np.maximum(inside - self.allowed_inside, 0) + height**2 / 2)


@dataclass(frozen=True)
class Usual:
    """Mean and standard deviation of the agreement over places: with steps, and with ground, where these are known."""

    steps: tuple[float, float]
    ground: tuple[float, float] | None

    def score(self, steps: Array32, ground: Array32 | None) -> Array32:
        """Agreement in standard deviations; that of the ground is zero where it is unknown."""
        mean, spread = self.steps
        found = (steps - mean) / spread
        if ground is None or self.ground is None:
            return found
        mean, spread = self.ground
        return np.asarray(found + np.nan_to_num(np.maximum((ground - mean) / spread, LEAST_GROUND)), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class PlanScores:
    """Scores of a component on a map; what is needed of a scale is computed once."""

    model: PlanModel
    target: PlanTarget
    options: ScoreOptions
    _of_scale: dict[int, tuple[PlanPoints, Usual | None]] = field(default_factory=dict)

    def at(self, enu_from_level: Similarity) -> float:
        """The score of a similarity, see `PlanHypothesis`; NaN where too little of the component is on the map.

        The best within a cell: walls are not known better on either side.
        """
        found = self.around(enu_from_level, 1)
        return float(np.nanmax(found)) if np.isfinite(found).any() else float("nan")

    def around(self, enu_from_level: Similarity, reach: int) -> Array:
        """Scores (2 reach + 1, 2 reach + 1) of the similarity moved by whole cells, rows going south."""
        side, scale = 2 * reach + 1, enu_from_level.scale
        points, typical = self._at_scale(scale)
        if typical is None:
            return np.full((side, side), np.nan)
        moves = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2).astype(np.int32) - reach
        steps, inside, valid, ground = self._sums(points, enu_from_level, moves)
        scores = typical.score(steps, ground) - self.options.penalty(inside, scale)
        return np.where(valid, scores, np.nan).astype(np.float64).reshape(side, side)

    def shifted(self, enu_from_level: Similarity, east_north: Array) -> Array:
        """Scores (n,) as of `at` of the similarity moved by (n, 2) metres, to the nearest cells."""
        cells = np.round(east_north / self.target.grid.pixel_m).astype(int)
        reach = int(np.abs(cells).max()) + 1
        best = maximum_filter(np.nan_to_num(self.around(enu_from_level, reach), nan=-np.inf), 3)
        found = best[reach - cells[:, 1], reach + cells[:, 0]]
        return np.where(np.isfinite(found), found, np.nan)

    def _at_scale(self, scale: float) -> tuple[PlanPoints, Usual | None]:
        step = round(float(np.log(scale) / np.log(SCALE_STEP)))
        if step not in self._of_scale:
            near = SCALE_STEP**step
            points = self.model.points(self.target.grid.pixel_m / near)
            self._of_scale[step] = points, self._usual(points, near)
        return self._of_scale[step]

    def _usual(self, points: PlanPoints, scale: float) -> Usual | None:
        """Of places all over the map; None where too few are possible."""
        rng, (rows, columns) = np.random.default_rng(0), self.target.known.shape
        found = []
        for azimuth in AZIMUTHS:
            c, s = scale * np.cos(azimuth), scale * np.sin(azimuth)
            turn = Similarity(scale, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, scale]]) / scale, np.zeros(3))
            east, north = turn.apply(np.array([[*self.model.centre, 0.0]]))[0, :2]
            # The component's middle at the first cell, then all over the map.
            corner = np.array([self.target.grid.east0 - east, self.target.grid.north0 - north, 0.0])
            places = rng.integers(0, [columns, rows], (USUAL_PLACES, 2), dtype=np.int32)
            steps, _, valid, ground = self._sums(points, Similarity(1.0, np.eye(3), corner) @ turn, places)
            found.append((steps[valid], (np.full_like(steps, np.nan) if ground is None else ground)[valid]))
        steps, ground = (np.concatenate(part) for part in zip(*found, strict=True))
        if len(steps) < MIN_USUAL:
            return None
        known = ground[np.isfinite(ground)]
        of_ground = (float(known.mean()), max(float(known.std()), 1e-6)) if len(known) >= MIN_USUAL else None
        return Usual((float(steps.mean()), max(float(steps.std()), 1e-9)), of_ground)

    def _sums(
        self, points: PlanPoints, enu_from_level: Similarity, moves: Whole
    ) -> tuple[Array32, Array32, Mask, Array32 | None]:
        """Agreement with the steps, share of free space in houses, whether enough is on the map, ground; each (n,)."""
        turn, least = enu_from_level.rotation[:2, :2], self.options.on_map
        normals = (points.normals @ turn.T * [1, -1]).astype(np.float32)
        weight = np.hypot(*normals.T)
        east, south, known = self.target.steps_and_known
        on_walls, in_free = (
            moved_cells(self._cells(enu_from_level, xy), moves, self.target.known.shape)
            for xy in (points.walls, points.free)
        )
        steps = east.take(on_walls) @ normals[:, 0] + south.take(on_walls) @ normals[:, 1]
        on_map = known.take(on_walls) @ weight >= least * weight.sum()
        free_known = known.take(in_free) @ points.freedom
        valid = on_map & (free_known >= least * points.freedom.sum())
        inside = self.target.padded_raised.take(in_free) @ points.freedom / np.maximum(free_known, 1e-6)
        if self.target.colour is None:
            return steps, inside, valid, None
        cells = GroundCells(self._cells(enu_from_level, points.ground), points.channels)
        return steps, inside, valid, cells.agreement(self.target.colour, moves)

    def _cells(self, enu_from_level: Similarity, xy: Array) -> Whole:
        """Cells (n, 2), u and v, of plan positions of the level frame."""
        enu = enu_from_level.apply(np.column_stack([xy, np.zeros(len(xy))]))
        return np.floor(self.target.grid.px_from_enu(enu[:, :2])).astype(np.int32)
