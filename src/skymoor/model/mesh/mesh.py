# SPDX-License-Identifier: Apache-2.0
"""The mesh model: depth maps fused to a surface, rendered by ray casting, coloured from the photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from skymoor.engines.options import FIXED
from skymoor.engines.raycast import RayCaster
from skymoor.errors import DegenerateGeometry
from skymoor.model.blend import Blend, BlendOptions
from skymoor.model.mesh._open3d import fuse_mesh
from skymoor.model.protocol import SceneBuilder, SceneModel
from skymoor.types import Array, Array32, Component, DepthMap, Progress, Render, View, no_progress


@dataclass(frozen=True)
class MeshBuilder:
    """Builds a `MeshModel`.

    Attributes:
        voxel_px: edge of a voxel in pixels of the depth maps.
        trunc_voxels: truncation of the signed distance, in voxels.
        min_weight: least number of depth maps that observe a voxel.
        max_sigma_ratio: depths with a larger standard deviation, as a fraction of depth, are not fused.
        max_voxels_across: largest number of voxels along the site's side; bounds memory.
        blend: how renders are coloured.
    """

    voxel_px: float = 2.0
    trunc_voxels: float = field(default=6.0, metadata=FIXED)
    min_weight: float = field(default=2.0, metadata=FIXED)
    max_sigma_ratio: float = field(default=0.02, metadata=FIXED)
    max_voxels_across: int = field(default=1500, metadata=FIXED)
    blend: BlendOptions = field(default_factory=BlendOptions, metadata=FIXED)

    def __call__(
        self,
        component: Component,
        depths: Sequence[DepthMap],
        *,
        progress: Progress = no_progress,
        checkpoint: Path | None = None,
    ) -> MeshModel:
        """Fuse the depth maps; takes seconds and ignores `checkpoint`; see `SceneBuilder`."""
        if not depths:
            raise DegenerateGeometry("no photo has a depth map")
        footprints = [np.median(m.depth[np.isfinite(m.depth)]) / m.camera.intrinsics.fx for m in depths]
        pixel = float(np.median(footprints))
        across = np.ptp(np.percentile(component.points[:, :2], [1, 99], axis=0), axis=0).max()
        voxel = max(self.voxel_px * pixel, across / self.max_voxels_across)
        vertices, triangles = fuse_mesh(
            depths,
            max_sigma_ratio=self.max_sigma_ratio,
            voxel=voxel,
            trunc_voxels=self.trunc_voxels,
            min_weight=self.min_weight,
            progress=progress,
        )
        return MeshModel(vertices, triangles, depths, pixel, self.blend)


_builder: type[SceneBuilder] = MeshBuilder


@dataclass(frozen=True, eq=False)
class MeshModel:
    """A triangle mesh in the `level` frame and the undistorted photos with their depths."""

    vertices: Array32
    triangles: NDArray[np.int32]
    maps: Sequence[DepthMap]
    pixel: float
    blend: BlendOptions

    @property
    def surface_points(self) -> Array:
        """The mesh's vertices; see `SceneModel`."""
        return np.asarray(self.vertices, dtype=np.float64)

    @cached_property
    def caster(self) -> RayCaster:
        """The ray caster of the mesh, made on first use."""
        return RayCaster(self.vertices, self.triangles)

    def render(self, view: View, *, progress: Progress = no_progress) -> Render:
        """Cast rays, fill holes from nearby (confidence 0), blend colours and confidence; see `SceneModel`."""
        xyz = self._cast(view)
        known = np.isfinite(xyz[..., 2])
        filled = _fill_holes(xyz, known, radius_px=0.03 * max(view.shape))
        blend = Blend(filled, view.view_from_level[2], self.blend)
        for done, depth_map in enumerate(self.maps):
            blend.add(depth_map, self._z_buffer(depth_map))
            progress(done + 1, len(self.maps))
        rgb, confidence = blend.result()
        confidence[~known] = 0
        filled[~blend.covered] = np.nan
        return Render(view, rgb, filled, confidence)

    def _cast(self, view: View) -> Array32:
        """xyz_level (h, w, 3) of the first surface along each ray, NaN where there is none."""
        h, w = view.shape
        xs = view.x0 + (np.arange(w) + 0.5) * view.pixel
        ys = view.y0 + (np.arange(h) + 0.5) * view.pixel
        start = float((self.vertices @ view.view_from_level[2]).min()) - 1.0
        origins_view = np.stack([*np.meshgrid(xs, ys), np.full((h, w), start)], axis=-1)
        origins = (origins_view @ view.view_from_level).astype(np.float32)
        direction = view.view_from_level[2].astype(np.float32)
        t = self.caster.cast(origins, np.broadcast_to(direction, origins.shape))
        t[~np.isfinite(t)] = np.nan
        return np.asarray(origins + t[..., None] * direction, dtype=np.float32)

    def _z_buffer(self, depth_map: DepthMap, reduce: int = 3) -> Array32:
        """z-depth of the mesh in a photo at 1/`reduce` of its size, infinite where no ray hits."""
        i = depth_map.camera.intrinsics
        small = i.resized(max(1, i.width // reduce), max(1, i.height // reduce))
        u, v = np.meshgrid(np.arange(small.width) + 0.5, np.arange(small.height) + 0.5)
        rays = small.rays(np.stack([u.ravel(), v.ravel()], axis=1)) @ depth_map.camera.cam_from_world.rotation
        directions = rays.reshape(small.height, small.width, 3).astype(np.float32)
        return self.caster.cast(depth_map.camera.centre.astype(np.float32), directions)


_model: type[SceneModel] = MeshModel


def _fill_holes(xyz: Array32, known: NDArray[np.bool_], radius_px: float) -> Array32:
    """Give pixels without a surface the smoothed depth of their surroundings, so that they can be coloured."""
    if known.all() or not known.any():
        return xyz.copy()
    distance, (rows, columns) = distance_transform_edt(~known, return_indices=True)
    nearest = xyz[rows, columns]
    fillable = distance <= radius_px
    smooth = cv2.blur(nearest, (15, 15))
    filled = np.where(known[..., None], xyz, np.where(fillable[..., None], smooth, np.nan)).astype(np.float32)
    # Only the depth is interpolated: the rays are known everywhere.
    return _on_rays(filled, xyz, known)


def _on_rays(filled: Array32, xyz: Array32, known: NDArray[np.bool_]) -> Array32:
    """Positions at interpolated depths, on the affine grid of rays fitted to the known points."""
    h, w = known.shape
    rows, columns = np.nonzero(known)
    subset = slice(None, None, max(1, len(rows) // 2000))
    rows, columns = rows[subset], columns[subset]
    design = np.column_stack([columns, rows, xyz[rows, columns, 2], np.ones(len(rows))])
    plan, *_ = np.linalg.lstsq(design, xyz[rows, columns, :2].astype(np.float64), rcond=None)
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    z = filled[..., 2]
    fitted = u[..., None] * plan[0] + v[..., None] * plan[1] + z[..., None] * plan[2] + plan[3]
    filled[..., :2] = np.where(known[..., None], filled[..., :2], fitted)
    return filled
