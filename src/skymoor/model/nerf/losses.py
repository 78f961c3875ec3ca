# SPDX-License-Identifier: Apache-2.0
"""Training losses: each is the mean over rays of a function of their volume rendering."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def photometric_loss(rgb: Tensor, target: Tensor, *, softness: float = 0.05) -> Tensor:
    """Charbonnier's loss of colours (n, 3): quadratic below `softness`, linear above (Barron 2019).

    The linear part limits the influence of moving objects and reflections.
    """
    return (torch.sqrt((rgb - target) ** 2 + softness**2) - softness).mean()


def depth_loss(weights: Tensor, edges: Tensor, depth: Tensor, sigma: Tensor, *, floor: float = 1e-2) -> Tensor:
    """Cross entropy of the termination distribution and the measured depth (DS-NeRF: Deng et al. 2022).

    Args:
        weights: (n, k) termination weights of the intervals between edges (n, k + 1).
        depth, sigma: (n,) measured depth and its standard deviation; rays with NaN are ignored.
        floor: is added to the weights, so that the loss of a wrong depth is at most -log of it.

    DS-NeRF uses a normal distribution. Where the logarithm of density is linear, the termination distribution has a
    long tail in front of the surface and a short one behind it, and a fit to a symmetric target is biased to too large
    depths. So the target has the field's own shape: the transmittance exp(-ln 2 exp(s (t - depth))) has its median at
    the measured depth and the standard deviation pi / (s sqrt 6) (Gumbel). It is integrated over each interval, also
    over wide ones.
    """
    measured = torch.isfinite(depth)
    slope = math.pi / math.sqrt(6) / torch.where(measured, sigma, 1.0)
    gap = edges - torch.where(measured, depth, 0.0)[:, None]
    transmittance = torch.exp(-math.log(2) * torch.exp((slope[:, None] * gap).clamp(max=20)))
    mass = (transmittance[:, :-1] - transmittance[:, 1:]).clamp(min=0)
    per_ray = -(mass * torch.log(weights + floor)).sum(dim=-1)
    return _mean_over(per_ray, measured)


def line_of_sight_loss(weights: Tensor, t: Tensor, depth: Tensor, sigma: Tensor, *, sigmas: float = 3.0) -> Tensor:
    """Squared termination weight more than `sigmas` standard deviations in front of the measured depth.

    Urban Radiance Fields: Rematas et al. 2022.
    """
    measured = torch.isfinite(depth)
    in_front = t < (depth - sigmas * sigma)[:, None]  # false where not measured
    return _mean_over((weights * in_front).sum(dim=-1) ** 2, measured)


def distortion_loss(weights: Tensor, t: Tensor, edges: Tensor, *, length: float = 10.0) -> Tensor:
    """Spread of the termination distribution (mip-NeRF 360: Barron et al. 2022), in units of `length`.

    Sum over pairs of w_i w_j |t_i - t_j| plus a third of w_i^2 times the interval. t (n, k) ascends, so that the
    double sum reduces to cumulative sums.
    """
    before = torch.cumsum(weights, dim=-1) - weights
    moment_before = torch.cumsum(weights * t, dim=-1) - weights * t
    pairs = 2 * (weights * (t * before - moment_before)).sum(dim=-1)
    own = (weights**2 * (edges[:, 1:] - edges[:, :-1])).sum(dim=-1) / 3
    return ((pairs + own) / length).mean()


def opacity_loss(opacity: Tensor, ends: Tensor) -> Tensor:
    """Square of the remaining transmittance, over the rays `ends` (n,) that must hit a surface."""
    return _mean_over((1 - opacity) ** 2, ends)


def ranking_loss(depth: Tensor, relative: Tensor, counts: Tensor, *, margin: float) -> Tensor:
    """Violation of the depth order of pairs of pixels (SparseNeRF: Wang et al. 2023).

    Args:
        depth: (n, 2) expected depths of two neighbouring pixels.
        relative: (n, 2) their monocular depths; only their order counts.
        counts: (n,) pairs that are used.
        margin: minimum difference of the depths.
    """
    sign = torch.sign(torch.nan_to_num(relative[:, 1] - relative[:, 0]))
    wrong = torch.relu(margin - sign * (depth[:, 1] - depth[:, 0]))
    return _mean_over(wrong, counts & (sign != 0))


def _mean_over(values: Tensor, counts: Tensor) -> Tensor:
    """Mean of the values where `counts`, 0 without any."""
    return torch.where(counts, values, 0.0).sum() / counts.sum().clamp(min=1)
