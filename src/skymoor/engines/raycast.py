# SPDX-License-Identifier: Apache-2.0
"""Rays against triangles: Embree, through Open3D, which is imported late because it takes seconds."""

from __future__ import annotations

import ctypes
import os
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import BackendUnavailable

Array32 = NDArray[np.float32]


def open3d() -> ModuleType:
    """Import Open3D; its wheel needs libusb, which few machines have: it is taken from a package."""
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
        import open3d as module
    except (ImportError, OSError) as error:
        raise BackendUnavailable(f"Open3D does not load ({error}): pip install open3d-cpu libusb-package") from error
    return module


class RayCaster:
    """Triangles (m, 3) of vertices (n, 3), ready for rays. `threads` work on each call; 0 takes all cores."""

    def __init__(self, vertices: Array32, triangles: NDArray[np.integer], *, threads: int = 0) -> None:
        o3d = open3d()
        self._threads = threads or os.cpu_count() or 1
        self._tensor: Any = o3d.core.Tensor
        self._scene: Any = o3d.t.geometry.RaycastingScene(nthreads=os.cpu_count() or 0)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def cast(self, origins: Array32, directions: Array32) -> Array32:
        """Distance (...,) along each ray in units of its direction, infinite where it hits nothing."""
        return np.asarray(self._cast(origins, directions)["t_hit"].numpy(), dtype=np.float32)

    def hits(
        self, origins: Array32, directions: Array32
    ) -> tuple[Array32, NDArray[np.int32], Array32, NDArray[np.float32]]:
        """Distance (...,), triangle (...,) or -1, barycentric position in it (..., 2), and its unit normal (..., 3)."""
        found = self._cast(origins, directions)
        # What Open3D calls invalid is the largest unsigned number, which is -1.
        triangle = found["primitive_ids"].numpy().view(np.int32)
        return found["t_hit"].numpy(), triangle, found["primitive_uvs"].numpy(), found["primitive_normals"].numpy()

    def occluded(self, origins: Array32, directions: Array32, *, reach: float = np.inf) -> NDArray[np.bool_]:
        """Whether anything (...,) lies on a ray nearer than `reach`, in units of its direction."""
        rays = self._rays(origins, directions)
        return np.asarray(self._scene.test_occlusions(rays, tfar=float(reach), nthreads=self._threads).numpy())

    def _cast(self, origins: Array32, directions: Array32) -> Any:
        return self._scene.cast_rays(self._rays(origins, directions), nthreads=self._threads)

    def _rays(self, origins: Array32, directions: Array32) -> Any:
        o, d = np.broadcast_arrays(origins, directions)
        return self._tensor(np.concatenate([o, d], axis=-1, dtype=np.float32))
