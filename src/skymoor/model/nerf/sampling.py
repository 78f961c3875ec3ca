# SPDX-License-Identifier: Apache-2.0
"""Where along a ray to look, and what a ray then sees."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from skymoor.model.nerf.box import Box

HALF = math.log(2)  # optical depth that lets half of the light through


@dataclass(frozen=True, eq=False)
class Proposal:
    """A voxel grid (nz, ny, nx) of the densities that were met, per inner unit. It is changed in place by `update`."""

    box: Box
    density: Tensor

    def to(self, device: torch.device) -> Proposal:
        """The same in another memory."""
        return replace(self, density=self.density.to(device))

    def look_up(self, unit: Tensor) -> Tensor:
        """Density (n,) of the cells of points (n, 3)."""
        return self.density.view(-1)[self._cells(unit)]

    def update(self, unit: Tensor, density: Tensor, rate: float = 0.1) -> None:
        """Move cells towards densities that were just computed in them; of several in one cell the largest counts.

        That one and not the last, since threads have no order.
        """
        cells, flat = self._cells(unit), self.density.view(-1)
        moved = torch.lerp(flat[cells], density.to(flat.dtype), rate)
        flat.scatter_reduce_(0, cells, moved, "amax", include_self=False)

    def _cells(self, unit: Tensor) -> Tensor:
        nz, ny, nx = self.density.shape
        size = unit.new_tensor([nx, ny, nz / self.box.height])
        cell = (unit * size).long()
        x, y, z = cell[..., 0].clamp_(0, nx - 1), cell[..., 1].clamp_(0, ny - 1), cell[..., 2].clamp_(0, nz - 1)
        return (z * ny + y) * nx + x

    def weights(self, origin: Tensor, direction: Tensor, near: Tensor, far: Tensor, bins: int) -> Tensor:
        """Light (n, bins) that ends in equal parts of rays from `near` to `far`."""
        step = (far - near) / bins
        t = near[:, None] + step[:, None] * (torch.arange(bins, device=near.device) + 0.5)
        points = origin[:, None] + t[..., None] * direction[:, None]
        density = self.look_up(self.box.unit_from_inner(points.view(-1, 3))).view(t.shape)
        return ray_weights(density, step[:, None].expand_as(density))[0]


def ray_weights(density: Tensor, length: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (n, k) of intervals of constant density, and the optical depth (n, k + 1) before each and behind all."""
    optical = functional.pad(torch.cumsum(density * length, dim=-1), (1, 0))
    through = torch.exp(-optical)
    return through[:, :-1] - through[:, 1:], optical


def sample_proposal(
    weights: Tensor, near: Tensor, far: Tensor, count: int, jitter: Tensor | None, *, floor: float = 0.02
) -> Tensor:
    """Distances (n, count), ascending, by the inverse of the weights' distribution.

    Args:
        weights: (n, bins) of equal parts from `near` to `far`.
        jitter: (n, count) uniform in [0, 1) within equal shares; None takes their middles.
        floor: share of the samples that is spread evenly.

    Each bin counts its neighbours as well: a surface may lie just beside the bin that was looked up.
    """
    bins = weights.shape[1]
    wide = functional.max_pool1d(weights[:, None], 3, 1, 1)[:, 0]
    share = wide / wide.sum(dim=-1, keepdim=True).clamp(min=1e-6)
    share = (1 - floor) * share + floor / bins
    upper = torch.cumsum(share, dim=-1)
    upper = upper / upper[:, -1:]
    places = torch.arange(count, device=weights.device) + (0.5 if jitter is None else jitter)
    wanted = (places / count).expand(len(weights), count).contiguous()
    bin_ = torch.searchsorted(upper, wanted, right=True).clamp(max=bins - 1)
    top = upper.gather(1, bin_)
    inside = 1 - ((top - wanted) / share.gather(1, bin_)).clamp(0, 1)
    return near[:, None] + (bin_ + inside) / bins * (far - near)[:, None]


def sample_measured(t: Tensor, depth: Tensor, sigma: Tensor, normal: Tensor) -> Tensor:
    """Put the first samples of rays with a measured depth around it.

    Args:
        t: (n, k) samples.
        depth, sigma: (n,), NaN where not measured.
        normal: (n, m) standard normal numbers, m < k.
    """
    m = normal.shape[1]
    # Those that stay are spread over the list, so that the air before and the ground behind keep some.
    order = torch.linspace(0, t.shape[1] - 1, m, device=t.device).round().long()
    around = depth[:, None] + sigma[:, None] * normal
    mixed = t.clone()
    mixed[:, order] = torch.where(torch.isfinite(around), around, t[:, order])
    return mixed.sort(dim=-1).values


@dataclass(frozen=True, eq=False)
class Seen:
    """What rays see.

    Attributes:
        edges: (n, k + 1) borders of intervals: the samples, and the end of the ray.
        centres: (n, k) where the light of the intervals ends, about.
        weights: (n, k) share of the light that ends in each.
        opacity, mean: (n,) share of the light that ends at all, and its mean depth.
        median: (n,) where half of the light has ended; the mean where less than that ends.
        variance: (n,) of depth, round the median.
    """

    edges: Tensor
    centres: Tensor
    weights: Tensor
    opacity: Tensor
    mean: Tensor
    median: Tensor
    variance: Tensor


def composite(density: Tensor, t: Tensor, far: Tensor) -> Seen:
    """Collect densities (n, k) at distances t (n, k), ascending, of rays that go on to `far` (n,).

    Between samples the logarithm of density is a straight line, as it is in the prior: constant pieces would let a
    surface into which it grows by e^5 per unit seem nearer than it is. The light before the first sample is left out,
    since samples crowd round the surface.
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
    share = weights / opacity.clamp(min=1e-6)[:, None]
    mean = (share * centres).sum(dim=-1)
    with torch.no_grad():
        median = torch.where(optical[:, -1] >= HALF, _half_way(density, growth, length, optical, edges), mean)
        variance = (share * (centres - median[:, None]) ** 2).sum(dim=-1)
    return Seen(edges, centres, weights, opacity, mean, median, variance)


def between(values: Tensor) -> Tensor:
    """Values (n, k, c) of intervals, from those at the samples that they begin with."""
    return torch.cat([(values[:, 1:] + values[:, :-1]) / 2, values[:, -1:]], dim=1)


def _half_way(density: Tensor, growth: Tensor, length: Tensor, optical: Tensor, edges: Tensor) -> Tensor:
    """Where the optical depth passes ln 2: density a e^(g s) has by then collected a (e^(g s) - 1) / g."""
    place = (optical[:, 1:] < HALF).sum(dim=-1, keepdim=True).clamp(max=density.shape[1] - 1)
    start, size = density.gather(1, place).clamp(min=1e-12), length.gather(1, place)
    rate = growth.gather(1, place) / size.clamp(min=1e-9)
    wanted = (HALF - optical.gather(1, place)).clamp(min=0) / start
    curved = torch.log1p((rate * wanted).clamp(min=-0.999)) / torch.where(rate.abs() > 1e-6, rate, 1.0)
    into = torch.where((rate * wanted).abs() > 1e-4, curved, wanted)
    return (edges.gather(1, place) + torch.minimum(into, size))[:, 0]
