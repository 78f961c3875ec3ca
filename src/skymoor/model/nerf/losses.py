# SPDX-License-Identifier: Apache-2.0
"""What a field is trained on: each loss is the mean over rays of a plain function of what the rays see."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def photometric_loss(rgb: Tensor, target: Tensor, *, softness: float = 0.05) -> Tensor:
    """Charbonnier's loss of colours (n, 3): quadratic below `softness`, linear above (Barron 2019).

    What moves between photos, and what glitters, pulls no harder than it must.
    """
    return (torch.sqrt((rgb - target) ** 2 + softness**2) - softness).mean()


def depth_loss(weights: Tensor, edges: Tensor, depth: Tensor, sigma: Tensor, *, floor: float = 1e-2) -> Tensor:
    """Cross entropy between where light ends and where depth was measured (DS-NeRF: Deng et al. 2022).

    Args:
        weights: (n, k) of the intervals between edges (n, k + 1).
        depth, sigma: (n,) measured, with its standard deviation; NaN rays do not count.
        floor: is added to the weights, so that a wrong depth in the air costs no more than -log of it.

    DS-NeRF takes a normal distribution. Light in a field whose logarithm of density is a straight line cannot end
    like that, but with a long tail before the surface and a short one behind, and fitted to a symmetric target it ends
    too deep. So the target is of the field's own shape: the transmittance exp(-ln 2 exp(s (t - depth))) has its median
    at the measured depth, and its standard deviation is pi / (s sqrt 6) (Gumbel). It is integrated over each interval,
    which stays right when they are wide.
    """
    measured = torch.isfinite(depth)
    slope = math.pi / math.sqrt(6) / torch.where(measured, sigma, 1.0)
    gap = edges - torch.where(measured, depth, 0.0)[:, None]
    through = torch.exp(-math.log(2) * torch.exp((slope[:, None] * gap).clamp(max=20)))
    mass = (through[:, :-1] - through[:, 1:]).clamp(min=0)
    per_ray = -(mass * torch.log(weights + floor)).sum(dim=-1)
    return _mean_over(per_ray, measured)


def line_of_sight_loss(weights: Tensor, t: Tensor, depth: Tensor, sigma: Tensor, *, sigmas: float = 3.0) -> Tensor:
    """Square of the light that ends clearly before the measured depth (Urban Radiance Fields: Rematas et al. 2022)."""
    measured = torch.isfinite(depth)
    early = t < (depth - sigmas * sigma)[:, None]  # false where not measured
    return _mean_over((weights * early).sum(dim=-1) ** 2, measured)


def distortion_loss(weights: Tensor, t: Tensor, edges: Tensor, *, length: float = 10.0) -> Tensor:
    """How far apart the places are where a ray's light ends (mip-NeRF 360: Barron et al. 2022), in units of `length`.

    Sum over pairs of w_i w_j |t_i - t_j| plus a third of w_i^2 times the interval. t (n, k) ascends, which makes the
    double sum a running one.
    """
    before = torch.cumsum(weights, dim=-1) - weights
    moment_before = torch.cumsum(weights * t, dim=-1) - weights * t
    pairs = 2 * (weights * (t * before - moment_before)).sum(dim=-1)
    own = (weights**2 * (edges[:, 1:] - edges[:, :-1])).sum(dim=-1) / 3
    return ((pairs + own) / length).mean()


def opacity_loss(opacity: Tensor, ends: Tensor) -> Tensor:
    """Square of the light that passes through the ground, over the rays `ends` (n,) that must end somewhere."""
    return _mean_over((1 - opacity) ** 2, ends)


def ranking_loss(depth: Tensor, relative: Tensor, counts: Tensor, *, margin: float) -> Tensor:
    """By how much pairs of pixels stand in the wrong order (SparseNeRF: Wang et al. 2023).

    Args:
        depth: (n, 2) expected depths of two neighbouring pixels.
        relative: (n, 2) their monocular depths; only which one is larger counts.
        counts: (n,) pairs that take part.
        margin: by how much the farther one must at least be farther.
    """
    sign = torch.sign(torch.nan_to_num(relative[:, 1] - relative[:, 0]))
    wrong = torch.relu(margin - sign * (depth[:, 1] - depth[:, 0]))
    return _mean_over(wrong, counts & (sign != 0))


def _mean_over(values: Tensor, counts: Tensor) -> Tensor:
    """Mean of the values that count, 0 where none does."""
    return torch.where(counts, values, 0.0).sum() / counts.sum().clamp(min=1)
