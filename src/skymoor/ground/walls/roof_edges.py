# SPDX-License-Identifier: Apache-2.0
"""Walls below the roof edges of a surface seen from above.

Near-vertical photos show too little of a wall for stereo on it, but its upper edge is a height step, and in the
orthophoto a straight line. A vertical plane below that line is the wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.geo import Grid
from skymoor.ground.wall_planes import Wall
from skymoor.types import Array, Array32, Image, Mask

SAMPLES = 25  # along a line
BESIDE_M = 0.4  # heights nearer to a line are of neither side
ROOF_M = 1.6  # beside a line, within which the heights of its upper side are the roof's
LOW_PERCENTILE = 15  # of the heights beside the lower side: cars and shrubs stand there
HEIGHT_LEVELS = 255


@dataclass(frozen=True, eq=False)
class SurfaceImage:
    """Colours (h, w, 3) and heights (h, w) in ENU metres, NaN where unknown, of a surface from above, on `grid`.

    `seen` (h, w) is false where heights are interpolated.
    """

    grid: Grid
    rgb: Image
    up: Array32
    seen: Mask


@dataclass(frozen=True)
class RoofEdgeOptions:
    """What counts as a roof edge.

    Attributes:
        min_line_m: shorter straight lines are dropped.
        min_step_m: smallest drop of height across a line.
        reach_m: distance beside a line up to which its lower side is looked for: what roofs hide is interpolated.
        max_roughness_m: largest robust spread of the heights along the upper side; those of trees vary more.
        join_m, join_deg, join_step_m: lines on one plane up to these tolerances in distance, azimuth and upper height
            belong to one wall,
        gap_m: unless they are this far apart.
        colour_weight: of lines of the orthophoto, against lines of the heights: they are sharper.
        min_length_m: shorter walls are dropped.
        min_covered: share of a wall's length on which there are lines.
        apart_m: of two parallel walls nearer than this, the one with fewer lines is dropped.
        max_walls: those with the longest lines are kept.
    """

    min_line_m: float = 2.5
    min_step_m: float = 2.0
    reach_m: float = 6.5
    max_roughness_m: float = 1.0
    join_m: float = 0.9
    join_deg: float = 8.0
    join_step_m: float = 2.5
    gap_m: float = 6.0
    colour_weight: float = 4.0
    min_length_m: float = 4.0
    min_covered: float = 0.5
    apart_m: float = 3.0
    max_walls: int = 80


@dataclass(frozen=True, eq=False)
class _Lines:
    """Straight height steps: ends (n, 2, 2) east-north, normals (n, 2) to the lower side, heights of both sides."""

    ends: Array
    normals: Array
    top: Array
    bottom: Array
    weight: Array

    @property
    def length(self) -> Array:
        return np.asarray(np.linalg.norm(self.ends[:, 1] - self.ends[:, 0], axis=1))

    def take(self, index: NDArray[np.intp]) -> _Lines:
        return _Lines(*(field[index] for field in (self.ends, self.normals, self.top, self.bottom, self.weight)))


def roof_edge_walls(surface: SurfaceImage, options: RoofEdgeOptions | None = None) -> list[Wall]:
    """Walls below the roof edges, those with the longest edges first; `area_m2` is that below the lines found.

    Their planes are as exact as the edges: some pixels of the surface. Overhanging eaves shift them outwards.
    """
    options = options or RoofEdgeOptions()
    lines = _lines(surface, options)
    left, walls = np.argsort(-lines.length * lines.weight), []
    while len(left):
        members, normal = _joined(lines, left, options)
        wall = _wall(lines.take(members), normal, options)
        if wall is not None:
            walls.append(wall)
        left = left[~np.isin(left, members)]
    walls = sorted(walls, key=lambda wall: -wall.area_m2 / (wall.z1 - wall.z0))
    return without_repeated(walls, (), options)[: options.max_walls]


def without_repeated(walls: Sequence[Wall], others: Sequence[Wall], options: RoofEdgeOptions) -> list[Wall]:
    """Walls, in order, that repeat neither one before nor one of the others."""
    kept: list[Wall] = []
    for wall in walls:
        if not any(_repeats(wall, other, options) for other in (*others, *kept)):
            kept.append(wall)
    return kept


def _lines(surface: SurfaceImage, options: RoofEdgeOptions) -> _Lines:
    """Lines of the orthophoto and of the heights with a drop of height beside them."""
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD)
    sources = [(_height_image(surface.up), 1.0), (cv2.cvtColor(surface.rgb, cv2.COLOR_RGB2GRAY), options.colour_weight)]
    ends, weights = [], []
    for image, weight in sources:
        found = detector.detect(image)[0]
        ends.append(np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(np.float64))
        weights.append(np.full(len(ends[-1]), weight))
    # The detector puts the first pixel's centre at the origin.
    px, weight_of = np.concatenate(ends) + 0.5, np.concatenate(weights)
    long = np.linalg.norm(px[:, 1] - px[:, 0], axis=1) * surface.grid.pixel_m >= options.min_line_m
    return _stepped(surface, surface.grid.enu_from_px(px[long]), weight_of[long], options)


def _height_image(up: Array32) -> Image:
    """Heights as grey levels, without speckles."""
    known = np.isfinite(up)
    if not known.any():
        return np.zeros(up.shape, np.uint8)
    low, high = np.percentile(up[known], [1, 99.5])
    grey = np.clip((np.nan_to_num(up, nan=low) - low) / max(high - low, 1e-6) * HEIGHT_LEVELS, 0, HEIGHT_LEVELS)
    return np.asarray(cv2.medianBlur(grey.astype(np.uint8), 5))


def _stepped(surface: SurfaceImage, ends: Array, weight: Array, options: RoofEdgeOptions) -> _Lines:
    """Those lines whose two sides differ in height, directed to the lower one."""
    if not len(ends):
        return _Lines(ends, np.zeros((0, 2)), np.zeros(0), np.zeros(0), weight)
    along = ends[:, 1] - ends[:, 0]
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    normal = np.column_stack([-unit[:, 1], unit[:, 0]])
    points = ends[:, :1] + np.linspace(0.05, 0.95, SAMPLES)[None, :, None] * along[:, None]
    steps = np.arange(BESIDE_M, options.reach_m, max(surface.grid.pixel_m, 0.2))
    on_roof = steps <= ROOF_M
    top, low, rough, known = [], [], [], []
    for side in (1, -1):
        beside = points[:, None] + side * normal[:, None, None] * steps[None, :, None, None]
        heights = _nearest(surface, beside).reshape(len(ends), len(steps), SAMPLES)
        roof = heights[:, on_roof].reshape(len(ends), -1)
        seen = np.asarray(np.isfinite(roof).any(axis=1))
        known.append(np.where(seen, np.isfinite(heights).mean(axis=(1, 2)), 0.0))
        # Lines without heights are dropped below; zeros keep NaN out of the statistics.
        roof = np.where(seen[:, None], roof, 0.0)
        top.append(np.nanmedian(roof, axis=1))
        rough.append(1.4826 * np.nanmedian(np.abs(roof - top[-1][:, None]), axis=1))
        low.append(np.nanpercentile(np.where(seen[:, None, None], heights, 0.0), LOW_PERCENTILE, axis=(1, 2)))
    first_is_roof = top[0] > top[1]
    roof_m, bottom = np.where(first_is_roof, top[0], top[1]), np.where(first_is_roof, low[1], low[0])
    roughness = np.where(first_is_roof, rough[0], rough[1])
    good = (np.minimum(*known) > 0.5) & (roof_m - bottom >= options.min_step_m)
    good &= (np.abs(top[0] - top[1]) > options.min_step_m / 2) & (roughness <= options.max_roughness_m)
    outwards = np.where(first_is_roof, -1.0, 1.0)[:, None] * normal
    return _Lines(ends, outwards, roof_m, bottom, weight).take(np.flatnonzero(good))


def _nearest(surface: SurfaceImage, plan: Array) -> Array:
    """Heights (...,) at plan positions (..., 2); NaN outside."""
    px = np.floor(surface.grid.px_from_enu(plan)).astype(np.int64)
    rows, columns = surface.up.shape
    inside = (px >= 0).all(axis=-1) & (px[..., 0] < columns) & (px[..., 1] < rows)
    px = np.where(inside[..., None], px, 0)
    return np.where(inside, surface.up[px[..., 1], px[..., 0]], np.nan)


def _joined(lines: _Lines, left: NDArray[np.intp], options: RoofEdgeOptions) -> tuple[NDArray[np.intp], Array]:
    """Lines on one plane with the first of `left`, and the plane's normal."""
    seed = int(left[0])
    normal, offset = lines.normals[seed], float(lines.ends[seed].mean(axis=0) @ lines.normals[seed])
    members = left[:1]
    for _ in range(3):
        near = np.abs(lines.ends[left] @ normal - offset).max(axis=1) <= options.join_m
        near &= lines.normals[left] @ normal >= np.cos(np.radians(options.join_deg))
        near &= np.abs(lines.top[left] - lines.top[seed]) <= options.join_step_m
        near |= left == seed
        members = _connected(lines, left[near], seed, normal, options.gap_m)
        weight = np.repeat(lines.length[members] * lines.weight[members], 2)
        points = lines.ends[members].reshape(-1, 2)
        centre = np.average(points, axis=0, weights=weight)
        arms = (points - centre) * np.sqrt(weight)[:, None]
        fitted = np.linalg.eigh(arms.T @ arms)[1][:, 0]
        normal = fitted if fitted @ lines.normals[seed] > 0 else -fitted
        offset = float(centre @ normal)
    return members, normal


def _connected(lines: _Lines, members: NDArray[np.intp], seed: int, normal: Array, gap_m: float) -> NDArray[np.intp]:
    """The lines that are connected with the seed along the wall, with gaps up to `gap_m`."""
    s = np.sort(lines.ends[members] @ [-normal[1], normal[0]], axis=1)
    order = np.argsort(s[:, 0])
    reached = np.maximum.accumulate(s[order, 1])
    piece = np.concatenate([[0], np.cumsum(s[order[1:], 0] - reached[:-1] > gap_m)])
    own = piece[np.flatnonzero(members[order] == seed)[0]]
    return np.asarray(members[order[piece == own]], dtype=np.intp)


def _wall(lines: _Lines, normal: Array, options: RoofEdgeOptions) -> Wall | None:
    s = np.sort(lines.ends @ [-normal[1], normal[0]], axis=1)
    s0, s1 = float(s.min()), float(s.max())
    covered = _union(s)
    if s1 - s0 < options.min_length_m or covered < options.min_covered * (s1 - s0):
        return None
    weight = lines.length * lines.weight
    offset = float(np.average(lines.ends.mean(axis=1) @ normal, weights=weight))
    z0, z1 = float(np.percentile(lines.bottom, 30)), float(np.average(lines.top, weights=weight))
    return Wall(normal, offset, s0, s1, z0, z1, covered * (z1 - z0))


def _union(intervals: Array) -> float:
    """Length of the union of intervals (n, 2)."""
    length, end = 0.0, -np.inf
    for low, high in intervals[np.argsort(intervals[:, 0])].tolist():
        length += max(high - max(low, end), 0.0)
        end = max(end, high)
    return length


def _repeats(wall: Wall, other: Wall, options: RoofEdgeOptions) -> bool:
    """Whether most of a wall lies close to another one of the same direction, at an overlapping height."""
    if wall.normal @ other.normal < np.cos(np.radians(2 * options.join_deg)):
        return False
    middle = wall.centre[:2]
    if abs(middle @ other.normal - other.offset) > options.apart_m:
        return False
    ends = wall.corners[:, :2] @ other.right
    shared = min(ends.max(), other.s1) - max(ends.min(), other.s0)
    high = min(wall.z1, other.z1) - max(wall.z0, other.z0)
    return bool(shared > 0.5 * (wall.s1 - wall.s0) and high > 0.5 * min(wall.z1 - wall.z0, other.z1 - other.z0))
