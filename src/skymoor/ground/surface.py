# SPDX-License-Identifier: Apache-2.0
"""Points with normals from depth maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array32, DepthMap, Mask

HALF_BASE_PX = 3
"""Normals are computed from points this far to all sides: nearer ones show the noise of the depth."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Points (n, 3) and unit normals (n, 3) that face the cameras, both in the cameras' world frame."""

    xyz: Array32
    normals: Array32

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, index: Mask | NDArray[np.intp]) -> Surface:
        """Keep some of the points."""
        return Surface(self.xyz[index], self.normals[index])


def surface_of(maps: Sequence[DepthMap], *, max_sigma_ratio: float = 0.02, stride: int = 1) -> Surface:
    """Points of all depth maps with a depth more certain than `max_sigma_ratio` of it, at every `stride`-th pixel.

    Where the depth steps between the neighbours of a pixel no normal exists, and the point is left out.
    """
    parts = [_of_one(depth_map, max_sigma_ratio, stride) for depth_map in maps]
    if not parts:
        return Surface(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    return Surface(np.concatenate([p.xyz for p in parts]), np.concatenate([p.normals for p in parts]))


def _of_one(depth_map: DepthMap, max_sigma_ratio: float, stride: int) -> Surface:
    intrinsics, k = depth_map.camera.intrinsics, HALF_BASE_PX
    with np.errstate(invalid="ignore"):
        depth = np.where(depth_map.sigma < max_sigma_ratio * depth_map.depth, depth_map.depth, np.nan)
    if min(depth.shape) <= 2 * k:
        return Surface(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    u, v = np.meshgrid(np.arange(depth.shape[1]) + 0.5, np.arange(depth.shape[0]) + 0.5)
    x, y = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    xyz = np.stack([x * depth, y * depth, depth], axis=-1).astype(np.float32)
    inner, every = slice(k, -k), slice(None, None, stride)
    across = (xyz[inner, 2 * k :] - xyz[inner, : -2 * k])[every, every]
    down = (xyz[2 * k :, inner] - xyz[: -2 * k, inner])[every, every]
    centre = xyz[inner, inner][every, every]
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=-1)
    # A slope of the depth beyond this many times its value per unit of the image plane is a step, not a surface.
    limit = 3.5 * 2 * k / intrinsics.fx * centre[..., 2]
    with np.errstate(invalid="ignore"):
        good = (np.abs(across[..., 2]) < limit) & (np.abs(down[..., 2]) < limit) & (length > 0)
    xyz_cam, normals = centre[good], normals[good] / length[good, None]
    normals *= np.where(np.einsum("ij,ij->i", normals, xyz_cam) > 0, -1, 1)[:, None]
    rotation = depth_map.camera.cam_from_world.rotation.astype(np.float32)
    # Added in double precision: a model need not lie near its origin.
    points = (xyz_cam @ rotation).astype(np.float64) + depth_map.camera.centre
    return Surface(points.astype(np.float32), normals @ rotation)
