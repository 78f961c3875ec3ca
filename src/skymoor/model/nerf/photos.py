# SPDX-License-Identifier: Apache-2.0
"""All pixels of the photos as one list, and their rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from skymoor.model.nerf.box import INNER_PER_LEVEL, Box
from skymoor.types import Array32, DepthMap


@dataclass(frozen=True, eq=False)
class Rays:
    """Pixels with their rays, inner frame; `depth` and `sigma` are distances along the unit directions.

    Attributes:
        image: (n,) number of the photo.
        origin, direction: (n, 3).
        near, far: (n,) distances of entry into the slab and exit; far < near where they miss it.
        rgb: (n, 3) in [0, 1].
        depth, sigma: (n,), NaN where not measured.
        relative: (n,) monocular depth, NaN where there is none.
    """

    image: Tensor
    origin: Tensor
    direction: Tensor
    near: Tensor
    far: Tensor
    rgb: Tensor
    depth: Tensor
    sigma: Tensor
    relative: Tensor

    @property
    def valid(self) -> Tensor:
        """Rays (n,) that cross the slab."""
        return self.far > self.near


@dataclass(frozen=True, eq=False)
class Pixels:
    """All pixels of all photos, flat, with the parameters of their rays.

    `first` (k + 1,) is where each photo begins, `width` (k,) its width; `ray` (k, 3, 3) turns (u, v, 1) into inner
    directions with z = 1 in the camera, `centre` (k, 3) is inner. `z`, `sigma_z` are depths along the optical axis.
    """

    box: Box
    first: Tensor
    width: Tensor
    ray: Tensor
    centre: Tensor
    rgb: Tensor
    z: Tensor
    sigma_z: Tensor
    relative: Tensor | None

    def __len__(self) -> int:
        return int(self.first[-1])

    def rays(self, index: Tensor) -> Rays:
        """Rays through the centres of the pixels `index` (n,)."""
        image = torch.searchsorted(self.first, index, right=True) - 1
        local = index - self.first[image]
        width = self.width[image]
        v = torch.div(local, width, rounding_mode="floor")
        pixel = torch.stack([local - v * width + 0.5, v + 0.5, torch.ones_like(v, dtype=torch.float32)], dim=-1)
        direction = torch.einsum("nij,nj->ni", self.ray[image], pixel)
        length = direction.norm(dim=-1)
        direction = direction / length[:, None]
        origin = self.centre[image]
        near, far = self.box.span(origin, direction)
        rgb = self.rgb[index].to(torch.float32) / 255
        depth, sigma = self.z[index] * length, self.sigma_z[index] * length
        unknown = torch.full_like(depth, float("nan"))
        relative = unknown if self.relative is None else self.relative[index].to(torch.float32)
        return Rays(image, origin, direction, near, far, rgb, depth, sigma, relative)

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """Random pixels (count,); with monocular depths, consecutive pairs are at most 16 pixels apart."""
        if self.relative is None:
            return torch.randint(len(self), (count,), generator=generator).to(self.first.device)
        index = torch.randint(len(self), (count // 2,), generator=generator).to(self.first.device)
        image = torch.searchsorted(self.first, index, right=True) - 1
        shift = torch.randint(-16, 17, (2, count // 2), generator=generator).to(self.first.device)
        neighbour = index + shift[0] + shift[1] * self.width[image]
        last = self.first[image + 1] - 1
        return torch.stack([index, torch.minimum(torch.maximum(neighbour, self.first[image]), last)], dim=1).view(-1)


def make_pixels(
    maps: Sequence[DepthMap],
    box: Box,
    *,
    max_sigma_ratio: float,
    monocular: Sequence[Array32 | None] | None,
    halve: bool,
    device: torch.device,
) -> Pixels:
    """Flatten photos and depth maps, at half size with `halve`; `monocular` as `maps`."""
    parts = [
        _flat(m, mono, max_sigma_ratio, halve) for m, mono in zip(maps, monocular or [None] * len(maps), strict=True)
    ]
    sizes = [(part[0].shape[0], part[0].shape[1]) for part in parts]
    first = np.cumsum([0, *(h * w for h, w in sizes)])
    rotations, centres = [], []
    for depth_map, (h, w) in zip(maps, sizes, strict=True):
        matrix = depth_map.camera.intrinsics.resized(w, h).matrix()
        rotations.append(depth_map.camera.cam_from_world.rotation.T @ np.linalg.inv(matrix))
        centres.append(box.inner_from_level(depth_map.camera.centre))
    rgb, z, sigma, relative = (
        np.concatenate([part[k].reshape(-1, *part[k].shape[2:]) for part in parts]) for k in range(4)
    )
    return Pixels(
        box,
        torch.from_numpy(first).to(device),
        torch.tensor([w for _, w in sizes], device=device),
        torch.tensor(np.array(rotations), dtype=torch.float32, device=device),
        torch.tensor(np.array(centres), dtype=torch.float32, device=device),
        torch.from_numpy(rgb).to(device),
        torch.from_numpy(z).to(device),
        torch.from_numpy(sigma).to(device),
        None if monocular is None else torch.from_numpy(relative).to(device),
    )


def _flat(
    depth_map: DepthMap,
    monocular: Array32 | None,
    max_sigma_ratio: float,
    halve: bool,  # noqa: FBT001
) -> tuple[np.ndarray, Array32, Array32, np.ndarray]:
    h, w = depth_map.depth.shape
    with np.errstate(invalid="ignore"):
        certain = depth_map.sigma < max_sigma_ratio * depth_map.depth
    z = np.where(certain, depth_map.depth, np.nan).astype(np.float32) * np.float32(INNER_PER_LEVEL)
    sigma = np.where(certain, depth_map.sigma, np.nan).astype(np.float32) * np.float32(INNER_PER_LEVEL)
    relative = np.full((h, w), np.nan, np.float32)
    if monocular is not None:
        relative = cv2.resize(monocular, (w, h), interpolation=cv2.INTER_AREA)
    rgb = depth_map.rgb
    if halve:
        rgb = cv2.resize(rgb, (w // 2, h // 2), interpolation=cv2.INTER_AREA)
        z, sigma, relative = _halved(z), _halved(sigma, np.inf), _halved(relative, np.inf)
    return rgb, z, sigma, relative


def _halved(values: Array32, max_step: float = 0.01) -> Array32:
    """Means of two by two pixels, NaN where one is unknown or they differ by more than that share of their mean.

    The mean across an edge would lie on neither surface; one of the four pixels would be off by half a pixel, which on
    slanting ground is another depth.
    """
    h, w = (size // 2 for size in values.shape)
    blocks = values[: 2 * h, : 2 * w].astype(np.float32).reshape(h, 2, w, 2)
    mean = blocks.mean(axis=(1, 3))
    with np.errstate(invalid="ignore"):
        smooth = np.ptp(blocks, axis=(1, 3)) <= max_step * np.abs(mean)
    return np.where(smooth, mean, np.nan).astype(np.float32)
