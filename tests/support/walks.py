# SPDX-License-Identifier: Apache-2.0
"""A walk before a wall, and security cameras that see it too, without pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics
from skymoor.types import Camera, Component
from support.blocks import look_at, observed

Array = NDArray[np.float64]

PHONE = Intrinsics(640, 480, 490.0, 490.0, 320.0, 240.0, (-0.03, 0.0, 0.0, 0.0))
WIDE = (
    Intrinsics(640, 480, 385.0, 385.0, 320.0, 240.0, (-0.16, 0.0, 0.0, 0.0)),
    Intrinsics(640, 480, 410.0, 410.0, 320.0, 240.0, (-0.24, 0.0, 0.0, 0.0)),
)
WALL_M = 24.0
EYE_M = 1.6


def walk(
    n: int = 9, *, along_m: tuple[float, float] = (2.0, 22.0), roll_deg: float = 2.0, seed: int = 3
) -> list[Camera]:
    """Photos of one phone, some ten metres before a wall in the plane y = 0; people look ahead or back now and then."""
    rng = np.random.default_rng(seed)
    cameras = []
    for k, x in enumerate(np.linspace(*along_m, n)):
        centre = np.array([x, -10.0 + rng.normal(scale=0.7), EYE_M + rng.normal(scale=0.1)])
        target = np.array([x + (-5.0, 0.0, 5.0)[k % 3], 0.0, 2.6 + rng.normal(scale=0.4)])
        pose = look_at(centre, target, roll_deg=rng.normal(scale=roll_deg))
        cameras.append(Camera(f"walk_{k}", PHONE, pose))
    return cameras


def watchers() -> list[Camera]:
    """Two security cameras on poles, with lenses of their own."""
    poses = (
        look_at(np.array([7.0, -13.0, 4.0]), np.array([9.0, 0.0, 2.0])),
        look_at(np.array([17.0, -12.0, 4.5]), np.array([14.0, 0.0, 2.0])),
    )
    return [Camera(f"watcher_{k}", lens, pose) for k, (lens, pose) in enumerate(zip(WIDE, poses, strict=True))]


def wall_points(n: int = 700, *, seed: int = 1) -> Array:
    """Points (n, 3) on the wall, whose windows are 0.3 m deep, and some on the ground before it."""
    rng = np.random.default_rng(seed)
    wall = rng.uniform([0.0, 0.0, 0.0], [WALL_M, 0.3, 7.0], (n, 3))
    ground = rng.uniform([0.0, -6.0, -0.05], [WALL_M, 0.0, 0.05], (n, 3))
    return np.where((np.arange(n) % 6 == 0)[:, None], ground, wall)


def reconstructed(cameras: Sequence[Camera], points: Array, *, noise_px: float = 0.4, seed: int = 0) -> Component:
    """What these cameras observe of the points that two of them see."""
    often = np.bincount(observed(cameras, points).obs_point, minlength=len(points)) >= 2
    return observed(cameras, points[often], noise_px=noise_px, seed=seed)
