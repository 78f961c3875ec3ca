# SPDX-License-Identifier: Apache-2.0
"""Open3D's volume, behind one function."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.raycast import open3d
from skymoor.errors import DegenerateGeometry
from skymoor.types import Array32, DepthMap, Progress


def fuse_mesh(
    maps: Sequence[DepthMap],
    usable: Sequence[NDArray[np.bool_]],
    *,
    voxel: float,
    trunc_voxels: float,
    min_weight: float,
    progress: Progress,
) -> tuple[Array32, NDArray[np.int32]]:
    """Truncated signed distance volume (Curless and Levoy 1996) of depth maps, as vertices (n, 3) and triangles (m, 3).

    Raises:
        DegenerateGeometry: the depth maps hold no surface.
    """
    if not any(use.any() for use in usable):
        raise DegenerateGeometry("no depth map holds a depth that is certain enough")
    o3d = open3d()
    core = o3d.core
    device = core.Device("CPU:0")
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), ((1), (1)), voxel, 8, 20000, device
    )
    for done, (depth_map, use) in enumerate(zip(maps, usable, strict=True)):
        depth = np.where(use, depth_map.depth, 0).astype(np.float32)
        if depth.any():
            image = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(depth[..., None])))
            # Open3D takes the pixel by cutting off the fraction, so the first one's centre is at 0.5 as it is for us.
            matrix = core.Tensor(depth_map.camera.intrinsics.matrix())
            pose = core.Tensor(depth_map.camera.cam_from_world.matrix())
            far = float(depth.max()) * 1.01
            blocks = volume.compute_unique_block_coordinates(image, matrix, pose, 1.0, far, trunc_voxels)
            volume.integrate(blocks, image, matrix, pose, 1.0, far, trunc_voxels)
        progress(done + 1, len(maps))
    try:
        mesh = volume.extract_triangle_mesh(weight_threshold=min_weight)
    except RuntimeError as error:  # how Open3D says that the mesh is empty
        raise DegenerateGeometry("the depth maps hold no common surface") from error
    if "positions" not in mesh.vertex or "indices" not in mesh.triangle or not len(mesh.triangle.indices):
        raise DegenerateGeometry("the depth maps hold no common surface")
    return mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy().astype(np.int32)
