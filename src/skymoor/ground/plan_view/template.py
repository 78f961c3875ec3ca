# SPDX-License-Identifier: Apache-2.0
"""A levelled ground component in plan: steep surfaces with their normals, free space, and the colours of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.errors import DegenerateGeometry
from skymoor.ground.plan_view.ground_colour import (
    GroundCells,
    Whole,
    ground_cells,
    ground_layers,
    ground_picture,
    smoothed_layers,
    turned_layers,
)
from skymoor.ground.surface import surface_of
from skymoor.types import Array, Array32, DepthMap, Image, Mask

STEEP = 0.3  # largest vertical component of the unit normal of a steep surface
SIDE_PX = 400  # of the raster of a component; larger ones get larger pixels
FINEST = 0.12  # pixel of the raster in units of the level frame, about the cameras' height
LARGEST_COUNT = 30  # points in a pixel that count
SECTORS = 180  # of the view round a camera
SECTOR_QUANTILE = 0.3  # of the distances seen in a sector: what is nearer is free
MIN_RAYS, MIN_VIEWS, ENOUGH_VIEWS = 3, 2, 3
LOW = 1.0  # above the camera, level units: rays to higher points may pass over things
RAYS = 3000  # of a photo
MOST_POINTS = 2000  # of walls and of free space


@dataclass(frozen=True, eq=False)
class PlanPoints:
    """Points of a component in plan, of its level frame.

    Attributes:
        walls, normals: (n, 2) on steep surfaces, and their outward normals times their weight.
        free, freedom: (m, 2) in free space, and how free (m,), 0 to 1.
        ground, channels: (k, 2) on the ground, and their colours (3, k), as coarse as a map.
    """

    walls: Array
    normals: Array
    free: Array
    freedom: Array32
    ground: Array
    channels: Array32


@dataclass(frozen=True, eq=False)
class PlanModel:
    """Rasters (side, side) of a component in its level frame, rows going down in y.

    Attributes:
        normals: (2, side, side) outward normals of steep surfaces towards u and v, times their weight.
        free: (side, side) free space, 0 to 1.
        rgb, shown: (side, side, 3) colours of the ground, and where it is seen.
        pixel: in level units.
        centre: (2,) plan position of the raster's centre.
        cameras: (n, 3) centres.
    """

    normals: Array32
    free: Array32
    rgb: Image
    shown: Mask
    pixel: float
    centre: Array
    cameras: Array

    def at_scale(self, scale: float, cell_m: float) -> ScaledModel:
        """The rasters to be turned, in cells of a map where a level unit is `scale` metres."""
        zoom = self.pixel * scale / cell_m
        layers = np.dstack([*self.normals, self.free])
        plan, ground = (smoothed_layers(one, zoom) for one in (layers, ground_layers(self.rgb, self.shown)))
        return ScaledModel(plan, ground, zoom, max(8, int(np.ceil(self.free.shape[0] * zoom * np.sqrt(2)))))

    def points(self, cell: float) -> PlanPoints:
        """Some of its pixels as points; `cell` of the map they are compared with, in level units."""
        walls, free = np.hypot(*self.normals) > 0, self.free > 0
        (u, v), (columns, rows) = self._some(walls), self._some(free)
        zoom = self.pixel / cell
        size = max(8, int(np.ceil(self.free.shape[0] * zoom)))
        ground = ground_cells(smoothed_layers(ground_layers(self.rgb, self.shown), zoom), zoom, 0.0, size)
        on_ground = (ground.offsets + 0.5 - size / 2) * [1, -1] * cell + self.centre
        return PlanPoints(
            self._level(u, v),
            self.normals[:, v, u].T * [1, -1],
            self._level(columns, rows),
            self.free[rows, columns],
            on_ground,
            ground.channels,
        )

    def _some(self, chosen: Mask) -> tuple[Whole, Whole]:
        """Columns and rows of pixels, evenly, no more than `MOST_POINTS`."""
        v, u = np.nonzero(chosen)
        kept = np.linspace(0, len(u) - 1, min(len(u), MOST_POINTS)).astype(np.int64)
        return u[kept], v[kept]

    def _level(self, u: Whole, v: Whole) -> Array:
        """Plan positions (n, 2) of the centres of pixels."""
        px = np.column_stack([u, v]) + 0.5 - self.free.shape[0] / 2
        return np.asarray(px * [1, -1] * self.pixel + self.centre)


@dataclass(frozen=True, eq=False)
class ScaledModel:
    """A component at one scale: blurred layers of its plan and ground, and the side of the turned rasters in cells."""

    plan: Array32
    ground: Array32
    zoom: float
    size: int

    def turned(self, azimuth_rad: float) -> tuple[Array32, Array32]:
        """`normals` and `free` turned counter-clockwise."""
        u, v, free = np.moveaxis(turned_layers(self.plan, self.zoom, azimuth_rad, self.size), -1, 0)
        c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
        return np.stack([c * u + s * v, -s * u + c * v]).astype(np.float32), np.ascontiguousarray(free)

    def turned_ground(self, azimuth_rad: float) -> GroundCells:
        """The ground turned counter-clockwise, in cells from the corner of the other rasters."""
        return ground_cells(self.ground, self.zoom, azimuth_rad, self.size)


def plan_model(maps_level: Sequence[DepthMap], *, rng: np.random.Generator) -> PlanModel:
    """Steep surfaces, free space and ground of the depth maps of a levelled component, z up.

    Raises `DegenerateGeometry` where no depth map holds a steep surface.
    """
    surface = surface_of(maps_level, stride=2)
    steep = np.abs(surface.normals[:, 2]) < STEEP
    plan, normals = surface.xyz[steep, :2].astype(np.float64), surface.normals[steep, :2].astype(np.float64)
    if not len(plan):
        raise DegenerateGeometry("the photos' depth maps hold no steep surface")
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-9
    cameras = np.array([one.camera.centre for one in maps_level])
    centre = np.median(plan, axis=0)
    # Single far points, of wrong depths, do not enlarge the raster.
    reach = np.percentile(np.abs(plan - centre).max(axis=1), 98)
    reach = 1.1 * max(float(reach), float(np.abs(cameras[:, :2] - centre).max()))
    pixel = max(2 * reach / SIDE_PX, FINEST)
    side = int(np.ceil(2 * reach / pixel))

    def px(points: Array) -> Array:
        return (points - centre) * [1, -1] / pixel + side / 2

    free = np.zeros((side, side), np.float32)
    for one in maps_level:
        free += _free_before(one, px, side, rng)
    free = np.where(free >= min(MIN_VIEWS, len(maps_level)), np.minimum(free, ENOUGH_VIEWS) / ENOUGH_VIEWS, 0)
    free = free.astype(np.float32)
    rgb, shown = ground_picture(maps_level, free, pixel, centre)
    return PlanModel(_weighted(px(plan), normals * [1, -1], side), free, rgb, shown, pixel, centre, cameras)


def _weighted(px: Array, normals: Array, side: int) -> Array32:
    """Mean normals (2, side, side) of the points (n, 2), with weights that grow slowly with their number."""
    cell = np.floor(px).astype(np.int64)
    inside = (cell >= 0).all(axis=1) & (cell < side).all(axis=1)
    index = cell[inside, 1] * side + cell[inside, 0]
    count = np.bincount(index, minlength=side**2)
    sums = [np.bincount(index, column, minlength=side**2) for column in normals[inside].T]
    weight = np.log1p(np.minimum(count, LARGEST_COUNT)) / np.maximum(count, 1)
    return np.stack([(weight * one).reshape(side, side) for one in sums]).astype(np.float32)


def _free_before(depth_map: DepthMap, px: object, side: int, rng: np.random.Generator) -> Array32:
    """Free space (side, side), 0 or 1, of one photo: nearer than most of what it shows in each direction."""
    points = depth_map.points(step=2)[0].astype(np.float64)
    points = points[rng.permutation(len(points))[:RAYS]]
    camera = depth_map.camera.centre
    points = points[points[:, 2] < camera[2] + LOW]
    arms = points[:, :2] - camera[:2]
    sector = np.floor((np.arctan2(arms[:, 1], arms[:, 0]) + np.pi) / (2 * np.pi) * SECTORS).astype(np.int64)
    distance, free = np.linalg.norm(arms, axis=1), np.zeros((side, side), np.uint8)
    for number in np.unique(sector):
        seen = distance[sector == number]
        if len(seen) < MIN_RAYS:
            continue
        reach = 0.95 * float(np.quantile(seen, SECTOR_QUANTILE))
        angles = (number + np.array([0.0, 1.0])) / SECTORS * 2 * np.pi - np.pi
        tips = camera[:2] + reach * np.column_stack([np.cos(angles), np.sin(angles)])
        corners = px(np.vstack([camera[None, :2], tips]))  # type: ignore[operator]
        cv2.fillConvexPoly(free, np.round(corners).astype(np.int32), 1)
    return free.astype(np.float32)
