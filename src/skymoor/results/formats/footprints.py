# SPDX-License-Identifier: Apache-2.0
"""What of the ground each photo shows: the border of the image, cast on the surface model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio

from skymoor.geo import EnuFrame
from skymoor.geometry import Intrinsics
from skymoor.results.formats._crs import MapFrame
from skymoor.types import Array, Camera, Mask

PER_SIDE = 4
STEPS, HALVINGS = 64, 14
MOST_PIXELS = 4_000_000  # of the surface model, which is thinned out to that: metres are enough for an outline
FARTHEST = 10.0  # times the height above the ground: beyond it an outline says nothing
GROUND_PERCENTILE = 20

Heights = Callable[[Array], Array]
"""Up in metres of the surface below positions (n, 3) in ENU; NaN where it is not known."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """The outline (n, 2) on the ground of a photo in longitude and latitude, seen from above counter-clockwise.

    `surface_share` is the part of it that lies on the surface model; the rest is on a plane at `ground_up` metres.
    """

    image: str
    outline: Array
    surface_share: float
    ground_up: float


def footprint(camera: Camera, heights: Heights, ground_up: float, frame: EnuFrame) -> Footprint | None:
    """Of a camera in ENU; None where it shows the horizon, or ground farther than 10 times its height above it."""
    centre = camera.centre
    rays = camera.intrinsics.rays(_border(camera.intrinsics)) @ camera.cam_from_world.rotation
    drop = centre[2] - ground_up
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.hypot(rays[:, 0], rays[:, 1]) / -rays[:, 2]
    if drop <= 0 or not np.isfinite(rays).all() or not ((rays[:, 2] < 0) & (reach < FARTHEST)).all():
        return None
    hits, known = _cast(centre, rays / -rays[:, 2:], heights, ground_up)
    lat, lon, _ = frame.lla_from_enu(hits).T
    outline = np.column_stack([lon, lat])
    x, y = (outline - outline.mean(axis=0)).T
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return Footprint(camera.image, outline if area > 0 else outline[::-1], float(known.mean()), ground_up)


def ground_of(points: Array) -> float:
    """Up of a component's ground: a low percentile of its points (n, 3), which also lie on roofs and trees."""
    return float(np.percentile(points[:, 2], GROUND_PERCENTILE))


def surface_heights(path: Path, frame: EnuFrame) -> Heights:
    """The surface model of a run, thinned out."""
    with rasterio.open(path) as dsm:
        step = int(np.ceil(np.sqrt(dsm.width * dsm.height / MOST_PIXELS)))
        shape = (-(-dsm.height // step), -(-dsm.width // step))
        values = dsm.read(1, out_shape=shape, masked=True).astype(np.float64).filled(np.nan)
        t, scale = ~dsm.transform, np.array([shape[1] / dsm.width, shape[0] / dsm.height])
        chart = MapFrame(frame, dsm.crs.to_wkt())

    def heights(xyz_enu: Array) -> Array:
        xyz = chart.map_from_enu(xyz_enu)
        px = np.column_stack([xyz[:, :2] @ [t.a, t.b] + t.c, xyz[:, :2] @ [t.d, t.e] + t.f]) * scale
        u, v = np.floor(px).astype(int).T
        inside = (u >= 0) & (u < shape[1]) & (v >= 0) & (v < shape[0])
        found: Array = np.full(len(xyz), np.nan)
        # Heights of the file are above the ellipsoid; below a position, up differs by as much as its own height does.
        found[inside] = values[v[inside], u[inside]] - xyz[inside, 2] + xyz_enu[inside, 2]
        return found

    return heights


def no_heights(xyz_enu: Array) -> Array:
    """Where there is no surface model."""
    return np.full(len(xyz_enu), np.nan)


def _border(lens: Intrinsics) -> Array:
    s = np.arange(PER_SIDE) / PER_SIDE
    w, h = lens.width - 1.0, lens.height - 1.0
    zero = 0 * s
    sides = [(s * w, zero), (zero + w, s * h), (w - s * w, zero + h), (zero, h - s * h)]
    return np.concatenate([np.column_stack(side) for side in sides]) + 0.5


def _cast(centre: Array, rays: Array, heights: Heights, ground_up: float) -> tuple[Array, Mask]:
    """Where rays (n, 3) that fall by 1 first go below the surface, (n, 3), and whether that is known there (n,)."""

    def below(drop: Array) -> tuple[Mask, Mask]:
        points = centre + rays * drop[:, None]
        up = heights(points)
        known = np.isfinite(up)
        return points[:, 2] <= np.where(known, up, ground_up), known

    count, deepest = len(rays), _deepest(centre, rays, heights, ground_up)
    low, high = np.zeros(count), np.full(count, deepest)
    searching = np.ones(count, bool)
    for drop in np.linspace(0, deepest, STEPS + 1)[1:]:
        hit = below(np.full(count, drop))[0] & searching
        high[hit], searching = drop, searching & ~hit
        low[searching] = drop
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        hit, _ = below(middle)
        low, high = np.where(hit, low, middle), np.where(hit, middle, high)
    return centre + rays * high[:, None], below(high)[1]


def _deepest(centre: Array, rays: Array, heights: Heights, ground_up: float) -> float:
    """How far below the camera to search: to the lowest height that is near the outline on the plane."""
    drop = centre[2] - ground_up
    reached = [centre + rays * (drop * k) for k in np.linspace(0, 2, 17)]
    up = heights(np.concatenate(reached))
    lowest = float(np.nanmin(np.append(up, ground_up)))
    return float(centre[2] - lowest) + 1.0


def footprints_of(cameras: Sequence[Camera], heights: Heights, ground_up: float, frame: EnuFrame) -> list[Footprint]:
    """Those of all cameras that have one."""
    found = (footprint(camera, heights, ground_up, frame) for camera in cameras)
    return [one for one in found if one is not None]
