# SPDX-License-Identifier: Apache-2.0
"""The domain of a field: a slab of finite height, contracted in plan.

Three frames. `level` is the component's. `inner` is the same times 100, about metres at usual flying heights, with
its origin at the middle of the site. `unit` is the encodings' input: the site in the middle of [0, 1] x [0, 1] and its
surroundings contracted into the rim; height has the same scale as the middle, so that cells are cubes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from skymoor.errors import DegenerateGeometry
from skymoor.types import Array, DepthMap

INNER_PER_LEVEL = 100.0
RIM = 0.5  # width of the contracted rim, as a fraction of half the site's side


@dataclass(frozen=True)
class Box:
    """Position and size of the slab.

    Attributes:
        middle_level: plan position (2,) of the site's centre.
        half: half of the site's side, inner units.
        low, high: heights of the slab's floor and ceiling, inner units.
    """

    middle_level: tuple[float, float]
    half: float
    low: float
    high: float

    @property
    def height(self) -> float:
        """Height of the slab in unit coordinates."""
        return (self.high - self.low) / self.inner_per_unit

    @property
    def inner_per_unit(self) -> float:
        """Inner units per unit coordinate, within the site."""
        return 2 * (1 + RIM) * self.half

    def inner_from_level(self, xyz_level: Array) -> Array:
        """Inner coordinates of points (..., 3) of the level frame."""
        return np.asarray((xyz_level - [*self.middle_level, 0.0]) * INNER_PER_LEVEL)

    def level_from_inner(self, xyz_inner: Array) -> Array:
        """The inverse."""
        return np.asarray(xyz_inner / INNER_PER_LEVEL + [*self.middle_level, 0.0])

    def unit_from_inner(self, xyz: Tensor) -> Tensor:
        """Contract points (..., 3): identity within the site, finite outside, by the largest of |x| and |y|.

        The contraction of mip-NeRF 360 (Barron et al. 2022), in plan only: a spherical one would bend the ground.
        """
        plan = xyz[..., :2] / self.half
        far = plan.abs().amax(dim=-1, keepdim=True).clamp(min=1.0)
        plan = plan * (1 + RIM * (1 - 1 / far)) / far
        up = (xyz[..., 2:] - self.low) / self.inner_per_unit
        unit = torch.cat([(plan / (1 + RIM) + 1) / 2, up], dim=-1)
        # A single NaN coordinate would propagate to a whole table of features.
        return torch.nan_to_num(unit, nan=0.5).clamp(0.0, 1.0)

    def inner_from_unit(self, unit: Tensor) -> Tensor:
        """The inverse; the rim's outer border would be infinitely far and is limited to about 50 sites."""
        plan = (2 * unit[..., :2] - 1) * (1 + RIM)
        far = plan.abs().amax(dim=-1, keepdim=True).clamp(min=1.0)
        stretched = 1 / (1 - (far - 1) / RIM).clamp(min=0.02)
        up = unit[..., 2:] * self.inner_per_unit + self.low
        return torch.cat([plan / far * stretched * self.half, up], dim=-1)

    def stretch(self, xyz: Tensor) -> Tensor:
        """Inner units per unit coordinate (..., 3) along x, y and z at points (..., 3): the contraction's Jacobian.

        In the rim, the larger of the radial and the tangential factor is used for both.
        """
        far = (xyz[..., :2] / self.half).abs().amax(dim=-1).clamp(min=1.0)
        plan = torch.where(far > 1, torch.maximum(far**2 / RIM, far / (1 + RIM * (1 - 1 / far))), far)
        return torch.stack([plan, plan, torch.ones_like(plan)], dim=-1) * self.inner_per_unit

    def span(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        """Entry and exit of rays (n, 3) in the slab, as distances (n,) in units of the direction.

        Rays that do not descend get far < near. Very flat ones end three site widths after their entry.
        """
        down = -directions[:, 2]
        descends = down > 1e-3
        steep = torch.where(descends, down, torch.ones_like(down))
        near = ((origins[:, 2] - self.high) / steep).clamp(min=1e-3 * self.half)
        far = torch.minimum((origins[:, 2] - self.low) / steep, near + 6 * self.half)
        return torch.where(descends, near, torch.ones_like(near)), torch.where(descends, far, torch.zeros_like(far))


def covered_points(
    maps: Sequence[DepthMap], max_sigma_ratio: float, *, min_maps: int, across: int = 96, per_map: int = 20000
) -> Array:
    """Points (n, 3) of depth maps in plan cells measured by at least `min_maps` of them.

    Raises `DegenerateGeometry` when there are fewer than 100.
    """
    clouds = []
    for depth_map in maps:
        step = max(1, round(np.sqrt(depth_map.depth.size / per_map)))
        clouds.append(depth_map.points(max_sigma_ratio=max_sigma_ratio, step=step)[0])
    points = np.concatenate(clouds).astype(np.float64) if clouds else np.zeros((0, 3))
    if len(points) < 100:
        raise DegenerateGeometry("the depth maps hold fewer than 100 depths that are certain enough")
    low, high = np.percentile(points[:, :2], [2, 98], axis=0)
    cell = float((high - low).max()) / across
    owner = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    plan = np.floor((points[:, :2] - low) / cell).astype(np.int64) + across
    inside = ((plan >= 0) & (plan < 3 * across)).all(axis=1)
    points, owner, flat = points[inside], owner[inside], plan[inside] @ [3 * across, 1]
    observed = np.unique(np.column_stack([flat, owner]), axis=0)[:, 0]
    counts = np.bincount(observed, minlength=9 * across * across)
    kept = np.asarray(points[counts[flat] >= min_maps])
    if len(kept) < 100:
        raise DegenerateGeometry("the depth maps have no common surface")
    return kept


def make_box(points: Array, *, margin: float = 2.0) -> Box:
    """The box around points (n, 3) of the level frame, as `covered_points` returns; `margin` in inner units."""
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    middle = (low[:2] + high[:2]) / 2
    half = float((high - low)[:2].max()) / 2 * INNER_PER_LEVEL
    floor, ceiling = np.percentile(points[:, 2], [0.1, 99.9]) * INNER_PER_LEVEL
    if half <= 0:
        raise DegenerateGeometry("the depth maps cover no ground")
    return Box((float(middle[0]), float(middle[1])), half, float(floor) - margin, float(ceiling) + margin)
