# SPDX-License-Identifier: Apache-2.0
"""Blocks of cameras over points, without pictures: what geometry alone needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flight import make_cameras
from skymoor.types import Camera, Component

Array = NDArray[np.float64]


def observed(cameras: Sequence[Camera], points: Array, *, noise_px: float = 0.0, seed: int = 0) -> Component:
    """Every point in every picture that holds it, with noise on the pixels; colours tell points apart."""
    rng = np.random.default_rng(seed)
    owners, indices, pixels = [], [], []
    for k, camera in enumerate(cameras):
        i = camera.intrinsics
        px = i.px_from_cam(camera.cam_from_world.apply(points))
        with np.errstate(invalid="ignore"):
            (seen,) = np.nonzero((px >= 0).all(axis=1) & (px[:, 0] <= i.width) & (px[:, 1] <= i.height))
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
    """The flight of that kind over the ground points; each seen by two cameras or more."""
    cameras = make_cameras(kind)
    points = ground_points(n, relief_m=relief_m)
    often = np.bincount(observed(cameras, points).obs_point, minlength=n) >= 2
    return observed(cameras, points[often], noise_px=noise_px)
