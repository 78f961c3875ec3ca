# SPDX-License-Identifier: Apache-2.0
"""Where a person or a camera can stand: circuits round buildings, and views that nothing blocks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d

from skymoor.geometry import Intrinsics
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import GROUND_LABELS, Label, inside
from skymoor.simulate.world import World

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CIRCUIT_M = 10.0  # distance from the wall at which a circuit's steps are measured
STEP_M = 0.5
CELL_M = 0.25
BODY_M = 0.6  # free on all sides
VIEW_M = 1.2  # free in the direction of view
EYE_M = (1.0, 2.5)  # plausible heights of an eye above what is below it
NEAR_PLANT_M = 5.0
MAX_PLANT_SHARE = 0.3
MIN_WALL_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Circuit:
    """The way round a building, anticlockwise, one place each `STEP_M`.

    Place k is opposite the wall point `wall[k]` (m, 2), in the direction `outward[k]` (m, 2) from it.
    """

    wall: Array
    outward: Array

    @property
    def length_m(self) -> float:
        """Once round."""
        return len(self.wall) * STEP_M

    def places(self, distances_m: ArrayLike) -> Array:
        """Plan positions (m, n, 2) at distances (n,) from the wall."""
        d = np.asarray(distances_m, np.float64)[:, None]
        return self.wall[:, None] + d * self.outward[:, None]


def circuit_round(outline_enu: Array) -> Circuit:
    """The circuit of an outline (k, 2), whatever its shape."""
    low = outline_enu.min(axis=0) - CIRCUIT_M - 2.0
    size = np.ceil((outline_enu.max(axis=0) + CIRCUIT_M + 2.0 - low) / CELL_M).astype(int)
    outside = np.ones((int(size[1]), int(size[0])), np.uint8)
    cv2.fillPoly(outside, [np.rint((outline_enu - low) / CELL_M).astype(np.int32)], 0)
    near = cv2.distanceTransform(outside, cv2.DIST_L2, 5) * CELL_M <= CIRCUIT_M
    contours, _ = cv2.findContours(near.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    line = max(contours, key=len).reshape(-1, 2) * CELL_M + low
    line = gaussian_filter1d(line, 1.0 / CELL_M, axis=0, mode="wrap")
    closed = np.vstack([line, line[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(round(along[-1] / STEP_M), 4), endpoint=False)
    path = np.column_stack([np.interp(at, along, closed[:, k]) for k in (0, 1)])
    after = np.roll(path, -1, axis=0)
    if np.sum(path[:, 0] * after[:, 1] - path[:, 1] * after[:, 0]) < 0:
        path = path[::-1]
    wall = _nearest_on_outline(outline_enu, path)
    return Circuit(wall, (path - wall) / np.linalg.norm(path - wall, axis=1, keepdims=True))


def ground_up(world: World, plan: Array) -> Array:
    """Height (n,) of the ground, or of the water on it, at plan positions (n, 2)."""
    up = np.asarray(world.height(plan[:, 0], plan[:, 1]), dtype=np.float64)
    water = world.plan.water_up
    return up if water is None else np.maximum(up, water)


def free_places(world: World, scene: Scene, eyes: Array, *, eye_m: tuple[float, float] = EYE_M) -> Mask:
    """Whether eyes (n, 3) can be here: above ground or water by `eye_m`, outside of everything, with room around."""
    free = ~within_buildings(world, eyes[:, :2], margin_m=0.0)
    trees = np.asarray(world.plan.trees, np.float64).reshape(-1, 4)
    if len(trees):
        apart = np.linalg.norm(eyes[:, None, :2] - trees[None, :, :2], axis=2)
        free &= (apart > 0.35 * trees[:, 3] + 0.3).all(axis=1)
    index = np.flatnonzero(free)
    around = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    around = around[np.any(around != 0, axis=1)]
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    distance, _ = _cast(scene, eyes[index], np.broadcast_to(around, (len(index), *around.shape)))
    below, label = _cast(scene, eyes[index], np.broadcast_to([[0.0, 0.0, -1.0]], (len(index), 1, 3)))
    standing = (below[:, 0] >= eye_m[0]) & (below[:, 0] <= eye_m[1]) & np.isin(label[:, 0], GROUND_LABELS)
    free[index] = standing & (distance >= BODY_M).all(axis=1)
    return free


def within_buildings(world: World, plan: Array, *, margin_m: float) -> Mask:
    """Whether plan positions (n, 2) lie in a building, or nearer to one than `margin_m`."""
    found = np.zeros(len(plan), dtype=bool)
    for building in (*world.plan.buildings, *world.plan.distractors):
        outline = building.outline_enu
        found |= inside(outline, plan)
        if margin_m > 0:
            found |= np.linalg.norm(_nearest_on_outline(outline, plan) - plan, axis=1) < margin_m
    return found


def clear_views(
    scene: Scene, lens: Intrinsics, eyes: Array, rotations: Array, *, wall_share: float = MIN_WALL_SHARE
) -> Mask:
    """Whether cameras at (n, 3), cam_from_enu (n, 3, 3), have nothing before the lens, and walls in view."""
    u, v = np.meshgrid((np.arange(9) + 0.5) / 9 * lens.width, (np.arange(7) + 0.5) / 7 * lens.height)
    rays = lens.rays(np.column_stack([u.ravel(), v.ravel()]))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, label = _cast(scene, eyes, rays @ rotations)
    leaves = ((label == Label.PLANT) & (distance < NEAR_PLANT_M)).mean(axis=1)
    walls = np.isin(label, (Label.WALL, Label.GLASS)).mean(axis=1)
    return np.asarray((distance >= VIEW_M).all(axis=1) & (leaves < MAX_PLANT_SHARE) & (walls >= wall_share))


def _cast(scene: Scene, eyes: Array, rays: Array) -> tuple[Array, NDArray[np.uint8]]:
    """Distances and labels (n, m) along rays (n, m, 3)."""
    origins = np.broadcast_to(eyes[:, None], rays.shape).reshape(-1, 3)
    hits = scene.cast(origins, rays.reshape(-1, 3))
    return hits.distance.reshape(rays.shape[:2]).astype(np.float64), hits.label.reshape(rays.shape[:2])


def _nearest_on_outline(outline: Array, plan: Array) -> Array:
    """The nearest points (n, 2) of a polygon's border."""
    start, edge = outline, np.roll(outline, -1, axis=0) - outline
    share = np.sum((plan[:, None] - start) * edge, axis=2) / np.maximum(np.sum(edge**2, axis=1), 1e-12)
    points = start + np.clip(share, 0, 1)[..., None] * edge
    best = np.argmin(np.linalg.norm(points - plan[:, None], axis=2), axis=1)
    nearest: Array = points[np.arange(len(plan)), best]
    return nearest
