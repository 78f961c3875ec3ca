# SPDX-License-Identifier: Apache-2.0
"""Multi-resolution hash encoding (Mueller et al. 2022, Instant NGP) in plain PyTorch.

On a CPU the scatter of the backward pass dominates the cost. There, one corner of each cell is drawn with the
probability of its trilinear weight and gets the whole gradient: unbiased, with an eighth of the work.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from skymoor.model.nerf.options import Sizes

PRIMES = (2654435761 - 2**32, 805459861)  # of the spatial hash (Teschner et al. 2003), as signed 32-bit numbers


class HashGrid(nn.Module):
    """Features of points in [0, 1] x [0, 1] x [0, height]; levels that fit into their table are stored densely."""

    scale: Tensor
    offset: Tensor
    mask: Tensor
    stride: Tensor

    def __init__(self, sizes: Sizes, finest_cells: int, height: float, generator: torch.Generator) -> None:
        super().__init__()
        growth = np.linspace(0, 1, sizes.levels)
        cells = np.floor(sizes.base_cells * (max(finest_cells, sizes.base_cells) / sizes.base_cells) ** growth)
        corners = np.stack([cells + 2, cells + 2, np.ceil(cells * height) + 2], axis=1).astype(np.int64)
        limits = np.full(sizes.levels, 2**sizes.table_log2)
        limits[-1] = 2**sizes.finest_table_log2
        dense_entries = corners.prod(axis=1)
        self.dense = int(np.cumprod(dense_entries <= limits).sum())
        entries = np.where(np.arange(sizes.levels) < self.dense, dense_entries, limits)
        self.features = sizes.features
        self.stochastic = not sizes.exact_backward
        self.finest_first = int(entries[:-1].sum())
        self.register_buffer("scale", torch.tensor(cells, dtype=torch.float32), persistent=False)
        self.register_buffer("offset", _int32(np.cumsum([0, *entries[:-1]])), persistent=False)
        self.register_buffer("mask", _int32(limits - 1), persistent=False)
        strides = np.stack([corners[:, 0], corners[:, 0] * corners[:, 1]])
        strides[:, self.dense :] = np.array(PRIMES)[:, None]
        self.register_buffer("stride", _int32(strides), persistent=False)
        start = torch.rand((int(entries.sum()), sizes.features), generator=generator)
        self.table = nn.Parameter((2 * start - 1) * 1e-4)
        self._corners: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]] = self._eager_corners

    @property
    def width(self) -> int:
        """Length of a point's features."""
        return len(self.scale) * self.features

    def forward(self, unit: Tensor, draws: Tensor | None = None) -> Tensor:
        """Features (n, width) of points (n, 3).

        `draws` (n, 3), uniform in [0, 1), select the corners that get the gradient, which is accumulated directly in
        `table.grad`. Without them the result is differentiable, also with respect to the points.
        """
        index, weights, fraction = self._corners(unit)
        if draws is not None and self.stochastic and torch.is_grad_enabled():
            features: Tensor = _OneCorner.apply(  # type: ignore[no-untyped-call]
                self.table, index, weights, fraction, draws
            )
        else:
            features = _look_up(self.table, index, weights)
        return features.view(len(unit), -1)

    def compile_look_up(self) -> None:
        """Compile the look-up; without a working compiler the eager version remains in use."""
        compiled = torch.compile(self._eager_corners, dynamic=True)
        probe = torch.full((1024, 3), 0.25, device=self.table.device)
        try:
            compiled(probe)
        except Exception:  # a missing compiler raises various types
            return
        self._corners = compiled

    def finest_corners(self, unit: Tensor) -> tuple[Tensor, Tensor]:
        """Rows (n, 8) of the finest level's entries around points (n, 3), counted from `finest_first`, and weights."""
        index, weights, _ = self._corners(unit)
        return index[:, -1].long() - self.finest_first, weights[:, -1]

    def _eager_corners(self, unit: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Table rows (n, levels, 8) of the corners around points, their weights, and cell fractions (3, n, levels)."""
        position = unit.T[:, :, None] * self.scale
        cell = position.detach().floor()
        fraction = position - cell
        low = cell.to(torch.int32)
        x, y, z = low[0], low[1] * self.stride[0], low[2] * self.stride[1]
        xs, ys, zs = (x, x + 1), (y, y + self.stride[0]), (z, z + self.stride[1])
        gaps = 1 - fraction
        d = self.dense
        rows, weights = [], []
        for i in (0, 1):
            for j in (0, 1):
                flat, mixed = xs[i][:, :d] + ys[j][:, :d], xs[i][:, d:] ^ ys[j][:, d:]
                plan = (fraction if i else gaps)[0] * (fraction if j else gaps)[1]
                for k in (0, 1):
                    hashed = (mixed ^ zs[k][:, d:]) & self.mask[d:]
                    rows.append(torch.cat([flat + zs[k][:, :d], hashed], dim=1) + self.offset)
                    weights.append(plan * (fraction if k else gaps)[2])
        return torch.stack(rows, dim=-1), torch.stack(weights, dim=-1), fraction


class _OneCorner(torch.autograd.Function):
    """Interpolation whose backward pass adds the gradient to one corner per cell, in place in `table.grad`."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, index: Tensor, weights: Tensor, fraction: Tensor, draws: Tensor) -> Tensor:
        upper = (draws.T[:, :, None] < fraction).to(torch.int64)
        corner = upper[0] * 4 + upper[1] * 2 + upper[2]
        ctx.chosen = index.gather(2, corner[..., None]).view(-1).long()
        ctx.table = table
        return _look_up(table, index, weights)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, ...]:
        table: Tensor = ctx.table
        # A dense gradient of the whole table in every step would dominate the cost.
        if table.grad is None:
            table.grad = torch.zeros_like(table)
        table.grad.index_add_(0, ctx.chosen, gradients[0].to(table.dtype))
        return None, None, None, None, None


def _look_up(table: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Weighted sums (n * levels, features) of table rows."""
    return functional.embedding_bag(index.view(-1, 8), table, per_sample_weights=weights.view(-1, 8), mode="sum")


def _int32(values: Any) -> Tensor:
    return torch.tensor(np.asarray(values), dtype=torch.int32)
