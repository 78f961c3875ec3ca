# SPDX-License-Identifier: Apache-2.0
"""Sampling of rays, and volume rendering along them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from skymoor.model.nerf.box import Box

HALF = math.log(2)  # optical depth of transmittance 1/2


@dataclass(frozen=True, eq=False)
class Proposal:
    """A voxel grid (nz, ny, nx) of recent densities per inner unit. It is changed in place by `update`."""

    box: Box
    density: Tensor

    def to(self, device: torch.device) -> Proposal:
        """The same on another device."""
        return replace(self, density=self.density.to(device))

    def look_up(self, unit: Tensor) -> Tensor:
        """Density (n,) of the cells that contain points (n, 3), unit coordinates."""
        return self.density.view(-1)[self._cells(unit)]

    def update(self, unit: Tensor, density: Tensor, rate: float = 0.1) -> None:
        """Move cells towards newly computed densities; of several in one cell the largest counts.

        Not the last, which would depend on the order of threads.
        """
        cells, flat = self._cells(unit), self.density.view(-1)
        updated = torch.lerp(flat[cells], density.to(flat.dtype), rate)
        flat.scatter_reduce_(0, cells, updated, "amax", include_self=False)

    def _cells(self, unit: Tensor) -> Tensor:
        nz, ny, nx = self.density.shape
        size = unit.new_tensor([nx, ny, nz / self.box.height])
        cell = (unit * size).long()
        x, y, z = cell[..., 0].clamp_(0, nx - 1), cell[..., 1].clamp_(0, ny - 1), cell[..., 2].clamp_(0, nz - 1)
        return (z * ny + y) * nx + x

    def weights(self, origin: Tensor, direction: Tensor, near: Tensor, far: Tensor, bins: int) -> Tensor:
        """Termination weights (n, bins) of equal parts of rays from `near` to `far`."""
        step = (far - near) / bins
        t = near[:, None] + step[:, None] * (torch.arange(bins, device=near.device) + 0.5)
        points = origin[:, None] + t[..., None] * direction[:, None]
        density = self.look_up(self.box.unit_from_inner(points.view(-1, 3))).view(t.shape)
        return ray_weights(density, step[:, None].expand_as(density))[0]


def ray_weights(density: Tensor, length: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (n, k) of intervals of constant density, and the optical depth (n, k + 1) at their borders."""
    optical = functional.pad(torch.cumsum(density * length, dim=-1), (1, 0))
    transmittance = torch.exp(-optical)
    return transmittance[:, :-1] - transmittance[:, 1:], optical


def sample_proposal(
    weights: Tensor, near: Tensor, far: Tensor, count: int, jitter: Tensor | None, *, floor: float = 0.02
) -> Tensor:
    """Distances (n, count), ascending, by inverse transform sampling of the weights.

    Args:
        weights: (n, bins) of equal parts from `near` to `far`.
        jitter: (n, count) uniform in [0, 1) within equal strata; None for their midpoints.
        floor: share of the samples that is uniform.

    The weight of a bin is the maximum with its neighbours: a surface may lie just beside a sampled bin.
    """
    bins = weights.shape[1]
    widened = functional.max_pool1d(weights[:, None], 3, 1, 1)[:, 0]
    probability = widened / widened.sum(dim=-1, keepdim=True).clamp(min=1e-6)
    probability = (1 - floor) * probability + floor / bins
    upper = torch.cumsum(probability, dim=-1)
    upper = upper / upper[:, -1:]
    strata = torch.arange(count, device=weights.device) + (0.5 if jitter is None else jitter)
    quantiles = (strata / count).expand(len(weights), count).contiguous()
    bin_ = torch.searchsorted(upper, quantiles, right=True).clamp(max=bins - 1)
    top = upper.gather(1, bin_)
    inside = 1 - ((top - quantiles) / probability.gather(1, bin_)).clamp(0, 1)
    return near[:, None] + (bin_ + inside) / bins * (far - near)[:, None]


def sample_measured(t: Tensor, depth: Tensor, sigma: Tensor, normal: Tensor) -> Tensor:
    """Replace some samples of rays with a measured depth by samples around it.

    Args:
        t: (n, k) samples.
        depth, sigma: (n,), NaN where not measured.
        normal: (n, m) standard normal deviates, m < k.
    """
    m = normal.shape[1]
    # The replaced ones are spread over the list, so that samples remain in front of the surface and behind it.
    order = torch.linspace(0, t.shape[1] - 1, m, device=t.device).round().long()
    around = depth[:, None] + sigma[:, None] * normal
    samples = t.clone()
    samples[:, order] = torch.where(torch.isfinite(around), around, t[:, order])
    return samples.sort(dim=-1).values


@dataclass(frozen=True, eq=False)
class Composited:
    """Result of volume rendering along rays.

    Attributes:
        edges: (n, k + 1) borders of intervals: the samples, and the end of the ray.
        centres: (n, k) approximate centres of termination in the intervals.
        weights: (n, k) termination weight of each.
        opacity, mean: (n,) total termination weight, and mean depth of termination.
        median: (n,) depth of transmittance 1/2; the mean where transmittance remains higher.
        variance: (n,) of the termination depth, around the median.
    """

    edges: Tensor
    centres: Tensor
    weights: Tensor
    opacity: Tensor
    mean: Tensor
    median: Tensor
    variance: Tensor


def composite(density: Tensor, t: Tensor, far: Tensor) -> Composited:
    """Volume rendering of densities (n, k) at distances t (n, k), ascending, of rays that end at `far` (n,).

    Between samples the logarithm of density is linear, as in the prior: piecewise constant density would bias a surface
    at which it grows by e^5 per unit towards the camera. Density in front of the first sample is ignored, since samples
    are concentrated around the surface.
    """
    edges = torch.cat([t, torch.maximum(far[:, None], t[:, -1:])], dim=-1)
    length = edges[:, 1:] - edges[:, :-1]
    ends = torch.cat([density[:, 1:], density[:, -1:]], dim=-1)
    growth = torch.log(ends.clamp(min=1e-12) / density.clamp(min=1e-12))
    steep = growth.abs() > 1e-3
    safe = torch.where(steep, growth, 1.0)
    weights, optical = ray_weights(density * torch.where(steep, torch.expm1(safe) / safe, 1 + growth / 2), length)
    centres = torch.cat([(t[:, 1:] + t[:, :-1]) / 2, t[:, -1:]], dim=-1)
    opacity = weights.sum(dim=-1)
    probability = weights / opacity.clamp(min=1e-6)[:, None]
    mean = (probability * centres).sum(dim=-1)
    with torch.no_grad():
        median = torch.where(optical[:, -1] >= HALF, _median_depth(density, growth, length, optical, edges), mean)
        variance = (probability * (centres - median[:, None]) ** 2).sum(dim=-1)
    return Composited(edges, centres, weights, opacity, mean, median, variance)


def midpoints(values: Tensor) -> Tensor:
    """Values (n, k, c) at the middle of intervals, from those at the samples (n, k, c) at which they begin."""
    return torch.cat([(values[:, 1:] + values[:, :-1]) / 2, values[:, -1:]], dim=1)


def _median_depth(density: Tensor, growth: Tensor, length: Tensor, optical: Tensor, edges: Tensor) -> Tensor:
    """Depth (n,) at which the optical depth is ln 2; that of density a e^(g s) is a (e^(g s) - 1) / g."""
    interval = (optical[:, 1:] < HALF).sum(dim=-1, keepdim=True).clamp(max=density.shape[1] - 1)
    start, size = density.gather(1, interval).clamp(min=1e-12), length.gather(1, interval)
    rate = growth.gather(1, interval) / size.clamp(min=1e-9)
    remaining = (HALF - optical.gather(1, interval)).clamp(min=0) / start
    curved = torch.log1p((rate * remaining).clamp(min=-0.999)) / torch.where(rate.abs() > 1e-6, rate, 1.0)
    offset = torch.where((rate * remaining).abs() > 1e-4, curved, remaining)
    return (edges.gather(1, interval) + torch.minimum(offset, size))[:, 0]
