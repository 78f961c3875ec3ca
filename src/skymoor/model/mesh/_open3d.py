# SPDX-License-Identifier: Apache-2.0
"""TSDF fusion with Open3D."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.raycast import open3d
from skymoor.errors import DegenerateGeometry
from skymoor.types import Array32, DepthMap, Progress

NO_SURFACE = "the depth maps have no common surface"


def fuse_mesh(
    maps: Sequence[DepthMap],
    *,
    max_sigma_ratio: float,
    voxel: float,
    trunc_voxels: float,
    min_weight: float,
    progress: Progress,
) -> tuple[Array32, NDArray[np.int32]]:
    """Fuse depth maps by truncated signed distances (Curless and Levoy 1996): vertices (n, 3) and triangles (m, 3).

    Depths count whose standard deviation is below `max_sigma_ratio` of them.

    Raises:
        DegenerateGeometry: the depth maps have no common surface.
    """
    o3d = open3d()
    core = o3d.core
    device = core.Device("CPU:0")
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), ((1), (1)), voxel, 8, 20000, device
    )
    certain = False
    for done, depth_map in enumerate(maps):
        with np.errstate(invalid="ignore"):
            use = depth_map.sigma < max_sigma_ratio * depth_map.depth
        depth = np.where(use, depth_map.depth, 0).astype(np.float32)
        if depth.any():
            certain = True
            image = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(depth[..., None])))
            # Open3D truncates pixel coordinates, so the first pixel's centre is at 0.5, as in this project.
            matrix = core.Tensor(depth_map.camera.intrinsics.matrix())
            pose = core.Tensor(depth_map.camera.cam_from_world.matrix())
            far = float(depth.max()) * 1.01
            blocks = volume.compute_unique_block_coordinates(image, matrix, pose, 1.0, far, trunc_voxels)
            volume.integrate(blocks, image, matrix, pose, 1.0, far, trunc_voxels)
        progress(done + 1, len(maps))
    if not certain:
        raise DegenerateGeometry("no depth map has a depth of sufficient certainty")
    try:
        mesh = volume.extract_triangle_mesh(weight_threshold=min_weight)
    except RuntimeError as error:  # raised by Open3D for an empty mesh
        raise DegenerateGeometry(NO_SURFACE) from error
    if "positions" not in mesh.vertex or "indices" not in mesh.triangle or not len(mesh.triangle.indices):
        raise DegenerateGeometry(NO_SURFACE)
    return in_order(mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy().astype(np.int32))


def in_order(vertices: Array32, triangles: NDArray[np.int32]) -> tuple[Array32, NDArray[np.int32]]:
    """The same mesh by the positions of its vertices: Open3D's threads find them in another order each time."""
    order = np.lexsort(vertices.T)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    ranked = rank[triangles]
    first = ranked.argmin(axis=1)[:, None]
    turned = np.take_along_axis(ranked, (first + np.arange(3)) % 3, axis=1)
    return vertices[order], turned[np.lexsort(turned.T[::-1])]
