# SPDX-License-Identifier: Apache-2.0
"""Blocks of cameras over points, without pictures: what geometry alone needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics, Similarity
from skymoor.types import Camera, Component

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Sees = Callable[[Camera, Array], Mask]
"""Whether nothing stands between a camera and points (n, 3)."""

LENS = Intrinsics(400, 300, 392.0, 392.0, 201.2, 148.7, (-0.05, 0.012, 0.0, 0.0))


def look_at(centre: Array, target: Array, *, roll_deg: float = 0.0, up: Array | None = None) -> Similarity:
    """cam_from_world of a camera at `centre` whose axis meets `target`; `up` is upwards in the picture."""
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) if up is None else up)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    rotation = np.stack([c * x + s * y, c * y - s * x, z])
    return Similarity(1.0, rotation, -rotation @ centre)


def ring(
    n: int = 16, *, roll_deg: float = 0.5, common_roll_deg: float = 0.0, depression_deg: float = 45
) -> list[Camera]:
    """Cameras around the site at 60 m that look at its middle."""
    rng = np.random.default_rng(3)
    out = 60 / np.tan(np.radians(depression_deg))
    cameras = []
    for k, azimuth in enumerate(np.linspace(0, 2 * np.pi, n, endpoint=False)):
        centre = np.array([out * np.sin(azimuth), out * np.cos(azimuth), 60.0])
        pose = look_at(centre, np.zeros(3), roll_deg=common_roll_deg + rng.normal(scale=roll_deg))
        cameras.append(Camera(f"{k}", LENS, pose))
    return cameras


def strips(*, heading_deg: float = 0.0, tilt_deg: float = 1.0, there_and_back: bool = False) -> list[Camera]:
    """Twelve vertical photos from 60 m, all with one heading, or every second strip flown the other way."""
    rng = np.random.default_rng(4)
    north = np.array([np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg)), 0.0])
    cameras = []
    for row, e in enumerate((-30.0, -10.0, 10.0, 30.0)):
        up = -north if there_and_back and row % 2 else north
        for n in (-20.0, 0.0, 20.0):
            target = np.array([e, n, 0.0]) + np.tan(np.radians(tilt_deg)) * 60 * np.array([*rng.normal(size=2), 0])
            cameras.append(Camera(f"{e},{n}", LENS, look_at(np.array([e, n, 60.0]), target, up=up)))
    return cameras


def observed(
    cameras: Sequence[Camera], points: Array, *, noise_px: float = 0.0, seed: int = 0, sees: Sees | None = None
) -> Component:
    """Every point in every picture that holds it, with noise on the pixels; colours tell points apart."""
    rng = np.random.default_rng(seed)
    owners, indices, pixels = [], [], []
    for k, camera in enumerate(cameras):
        i = camera.intrinsics
        px = i.px_from_cam(camera.cam_from_world.apply(points))
        with np.errstate(invalid="ignore"):
            inside = (px >= 0).all(axis=1) & (px[:, 0] <= i.width) & (px[:, 1] <= i.height)
        (seen,) = np.nonzero(inside if sees is None else inside & sees(camera, points))
        owners.append(np.full(len(seen), k, np.int32))
        indices.append(seen.astype(np.int32))
        pixels.append(px[seen] + rng.normal(size=(len(seen), 2)) * noise_px)
    colours = rng.integers(0, 255, (len(points), 3)).astype(np.uint8)
    observations = np.concatenate(owners), np.concatenate(indices), np.concatenate(pixels)
    return Component(tuple(cameras), points, colours, *observations, reprojection_px=noise_px)


def ground_points(n: int, *, relief_m: float, slope_deg: float = 0.0, extent_m: float = 45.0, seed: int = 1) -> Array:
    """Points (n, 3) in ENU metres on a plane that rises to the east, with so much relief (uniform) on it."""
    rng = np.random.default_rng(seed)
    plan = rng.uniform(-extent_m, extent_m, (n, 2))
    height = np.tan(np.radians(slope_deg)) * plan[:, 0] + rng.uniform(0, relief_m, n)
    return np.column_stack([plan, height])


def block(kind: str, *, relief_m: float, noise_px: float = 0.3, n: int = 600) -> Component:
    """Points on the ground, each seen by two cameras or more.

    `oblique`: a ring that looks down at 45 degrees, and six photos from above. `nadir`: 12 photos from one height.
    """
    cameras = strips(there_and_back=True) if kind == "nadir" else [*ring(12), *strips()[::2]]
    points = ground_points(n, relief_m=relief_m)
    often = np.bincount(observed(cameras, points).obs_point, minlength=n) >= 2
    return observed(cameras, points[often], noise_px=noise_px)
