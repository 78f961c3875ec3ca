# SPDX-License-Identifier: Apache-2.0
"""Image-based colour and confidence of surface points.

Blended colours do not reveal wrong geometry: a roof that is three metres too low still renders well. So the pass that
blends colours also compares each point with the depth map of every photo that sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Array32, DepthMap, Image, Mask

Index = NDArray[np.intp]


@dataclass(frozen=True)
class BlendOptions:
    """Weights and thresholds of blending and of the agreement of depth maps.

    Attributes:
        angle_deg: angle between a photo's ray and the rendered one at which the photo's weight falls to 1/e.
        occlusion_ratio: a point is occluded in a photo if it lies behind the visible surface by more than this fraction
            of depth.
        agree_sigmas, agree_ratio: tolerance of agreement with a depth map, in standard deviations, and its minimum as a
            fraction of depth.
        sigma_ratio: standard deviation of fused depth, as a fraction of depth, that halves the confidence.
        views: scale of the saturation of confidence with the number of agreeing photos.
    """

    angle_deg: float = 10.0
    occlusion_ratio: float = 0.02
    agree_sigmas: float = 3.0
    agree_ratio: float = 0.004
    sigma_ratio: float = 0.006
    views: float = 2.0


class Blend:
    """Accumulates colours and depth agreement of photos over an image of surface points."""

    def __init__(self, xyz: Array32, direction: Array, options: BlendOptions) -> None:
        self._xyz = xyz
        self._direction = direction
        self._options = options
        shape = xyz.shape[:2]
        self._colour = np.zeros((*shape, 3), np.float32)
        self._weight = np.zeros(shape, np.float32)
        self._agree = np.zeros(shape, np.float32)
        self._disagree = np.zeros(shape, np.float32)
        self._information = np.zeros(shape, np.float32)

    def add(self, depth_map: DepthMap, z_buffer: Array32) -> None:
        """Add one photo's colours and depth agreement; `z_buffer` is the surface's z-depth in it, at any size."""
        window = self._window(depth_map)
        if window is None:
            return
        xyz = self._xyz[window].reshape(-1, 3)
        camera = depth_map.camera
        i = camera.intrinsics
        cam = xyz @ camera.cam_from_world.rotation.T.astype(np.float32) + camera.cam_from_world.translation.astype(
            np.float32
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            u = cam[:, 0] / cam[:, 2] * np.float32(i.fx) + np.float32(i.cx)
            v = cam[:, 1] / cam[:, 2] * np.float32(i.fy) + np.float32(i.cy)
            inside = (cam[:, 2] > 0) & (u > 1) & (v > 1) & (u < i.width - 1) & (v < i.height - 1)
        at = np.flatnonzero(inside)
        u, v, z = u[at], v[at], cam[at, 2]
        ratio = z_buffer.shape[1] / i.width, z_buffer.shape[0] / i.height
        surface = z_buffer[_index(v * ratio[1], z_buffer.shape[0]), _index(u * ratio[0], z_buffer.shape[1])]
        visible = z < surface * (1 + self._options.occlusion_ratio)
        at, u, v, z = at[visible], u[visible], v[visible], z[visible]
        self._add_colour(window, at, u, v, xyz[at], depth_map)
        self._add_agreement(window, at, u, v, z, depth_map)

    def result(self) -> tuple[Image, Array32]:
        """rgb (h, w, 3) and confidence (h, w) in [0, 1]."""
        o = self._options
        rgb = self._colour / np.maximum(self._weight, 1e-30)[..., None]
        agreement = self._agree / (self._agree + self._disagree + 0.5)
        enough = 1 - np.exp(-np.maximum(self._agree - 1, 0) / o.views)
        # Depth maps agreement photos, so their errors are correlated: count the information of two maps at most.
        mean_information = self._information / np.maximum(self._agree, 1)
        variance = 1 / np.maximum(mean_information * np.minimum(self._agree, 2), 1e-12)
        precise = 1 / (1 + variance / o.sigma_ratio**2)
        confidence = (agreement * enough * precise).astype(np.float32)
        return np.clip(rgb + 0.5, 0, 255).astype(np.uint8), confidence

    @property
    def covered(self) -> Mask:
        """Mask (h, w) of pixels with a colour from at least one photo."""
        return np.asarray(self._weight > 0)

    def _window(self, depth_map: DepthMap, step: int = 8) -> tuple[slice, slice] | None:
        """Part of the image that a photo can cover, from projecting every `step`-th point."""
        i = depth_map.camera.intrinsics
        coarse = self._xyz[::step, ::step]
        cam = depth_map.camera.cam_from_world.apply(coarse.reshape(-1, 3).astype(np.float64))
        with np.errstate(invalid="ignore", divide="ignore"):
            u = cam[:, 0] / cam[:, 2] * i.fx + i.cx
            v = cam[:, 1] / cam[:, 2] * i.fy + i.cy
            near = (cam[:, 2] > 0) & (np.abs(u / i.width - 0.5) < 0.6) & (np.abs(v / i.height - 0.5) < 0.6)
        rows, columns = np.nonzero(near.reshape(coarse.shape[:2]))
        if not len(rows):
            return None
        return (
            slice(max(0, (rows.min() - 1) * step), (rows.max() + 2) * step),
            slice(max(0, (columns.min() - 1) * step), (columns.max() + 2) * step),
        )

    def _add_colour(
        self, window: tuple[slice, slice], at: Index, u: Array32, v: Array32, xyz: Array32, depth_map: DepthMap
    ) -> None:
        rays = xyz - depth_map.camera.centre.astype(np.float32)
        cosine = rays @ self._direction.astype(np.float32) / np.linalg.norm(rays, axis=1)
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        weight = np.exp(-np.minimum((angle / self._options.angle_deg) ** 2, 60.0)).astype(np.float32)
        # Weights fade towards a photo's border to avoid seams.
        i = depth_map.camera.intrinsics
        edge = np.minimum(np.minimum(u, i.width - u), np.minimum(v, i.height - v)) / (0.1 * min(i.width, i.height))
        weight *= np.clip(edge, 0.01, 1)
        colour = _sample(depth_map.rgb, u, v)
        _accumulate(self._colour[window], at, colour * weight[:, None])
        _accumulate(self._weight[window], at, weight)

    def _add_agreement(
        self, window: tuple[slice, slice], at: Index, u: Array32, v: Array32, z: Array32, depth_map: DepthMap
    ) -> None:
        o = self._options
        row, column = _index(v, depth_map.depth.shape[0]), _index(u, depth_map.depth.shape[1])
        depth, sigma = depth_map.depth[row, column], depth_map.sigma[row, column]
        known = np.isfinite(depth)
        limit = np.maximum(o.agree_sigmas * np.minimum(sigma, 0.01 * z), o.agree_ratio * z)
        agree = known & (np.abs(depth - z) <= limit)
        _accumulate(self._agree[window], at, agree.astype(np.float32))
        _accumulate(self._disagree[window], at, (known & ~agree).astype(np.float32))
        information = np.where(agree, (z / np.where(agree, sigma, 1)) ** 2, 0)
        _accumulate(self._information[window], at, information.astype(np.float32))


def _sample(image: Image, u: Array32, v: Array32) -> Image:
    """Bilinear colours (n, 3); OpenCV limits rows to 32767, so the points are folded into an image."""
    rows = -(-len(u) // 1024)
    reshaped = [np.pad(x - 0.5, (0, rows * 1024 - len(x))).reshape(rows, 1024) for x in (u, v)]
    if not rows:
        return np.zeros((0, 3), np.uint8)
    colours = cv2.remap(image, reshaped[0], reshaped[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(colours.reshape(-1, 3)[: len(u)], dtype=np.uint8)


def _index(position: Array32, size: int) -> Index:
    return np.clip(position.astype(np.intp), 0, size - 1)


def _accumulate(target: Array32, at: Index, values: Array32) -> None:
    """Add at flat positions of a window; positions are unique, so no scatter-add is needed."""
    rows, columns = np.unravel_index(at, target.shape[:2])
    target[rows, columns] += values
