# SPDX-License-Identifier: Apache-2.0
"""Spatial uncertainty of a field by its photometric sensitivity to deformation, and the confidence of renders.

Bayes' Rays (Goli et al. 2024): where a smooth deformation of space does not change the rendered colours, such as on a
uniform roof or outside all photos, the surface is uncertain. The diagonal of the Hessian is estimated with random signs
(Hutchinson): one backward pass per batch of rays, whose mixed terms cancel on average.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from skymoor.model.nerf.field import Field
from skymoor.model.nerf.options import UncertaintyOptions
from skymoor.model.nerf.photos import Pixels
from skymoor.model.nerf.sampling import Proposal, composite, midpoints, sample_proposal
from skymoor.types import Array, Array32, Progress

BATCH_RAYS = 2048


@dataclass(frozen=True, eq=False)
class Deformation:
    """Standard deviations (3, nz, ny, nx) of the vertices' displacements along x, y and z, in unit coordinates."""

    sigma: Tensor

    def to(self, device: torch.device) -> Deformation:
        """The same on another device."""
        return Deformation(self.sigma.to(device))

    def along(self, field: Field, xyz: Tensor, direction: Tensor) -> Tensor:
        """Standard deviation (n,) of points (n, 3) along a direction (3,), in inner units."""
        box = field.box
        position = box.unit_from_inner(xyz) * xyz.new_tensor([2.0, 2.0, 2.0 / box.height]) - 1
        sampled = functional.grid_sample(
            self.sigma[None], position[None, None, None], mode="bilinear", padding_mode="border", align_corners=True
        )
        shifts = sampled.view(3, -1).T * box.stretch(xyz)
        along: Tensor = torch.linalg.vector_norm(shifts * direction, dim=-1)
        return along


def deformation_sigma(
    field: Field,
    proposal: Proposal,
    pixels: Pixels,
    options: UncertaintyOptions,
    *,
    pixel_inner: float,
    seed: int,
    progress: Progress,
) -> Deformation:
    """Laplace approximation of the posterior of the deformation, given the colours of all pixels."""
    generator = torch.Generator().manual_seed(seed)
    shape = _vertices(field.box.height, options.cells_across)
    hessian = torch.zeros(3, math.prod(shape), device=field.prior.device)
    squares, batches = 0.0, -(-options.rays // BATCH_RAYS)
    field.requires_grad_(False)  # noqa: FBT003
    for done in range(batches):
        slopes, error = _batch(field, proposal, pixels, shape, generator)
        hessian += slopes**2
        squares += error / batches
        progress(done + 1, batches)
    rays_ratio = len(pixels) / max(1, batches * BATCH_RAYS)
    widest = options.widest_px * pixel_inner / field.box.inner_per_unit
    precision = hessian * rays_ratio / max(squares, 1e-6) + 1 / widest**2
    return Deformation(precision.rsqrt().view(3, *shape))


def _batch(
    field: Field, proposal: Proposal, pixels: Pixels, shape: tuple[int, int, int], generator: torch.Generator
) -> tuple[Tensor, float]:
    """Derivatives (3, vertices) of randomly signed colours of a batch of rays, and the mean square of their errors."""
    rays = pixels.rays(torch.randint(len(pixels), (BATCH_RAYS,), generator=generator).to(pixels.first.device))
    near, far = rays.near, torch.where(rays.valid, rays.far, rays.near + 1)
    weights = proposal.weights(rays.origin, rays.direction, near, far, field.sizes.bins)
    t = sample_proposal(weights, near, far, field.sizes.render_samples, None)
    unit = field.box.unit_from_inner((rays.origin[:, None] + t[..., None] * rays.direction[:, None]).view(-1, 3))
    unit.requires_grad_()
    count = t.shape[1]
    density, colour = field(unit, rays.direction.repeat_interleave(count, 0), rays.image.repeat_interleave(count))
    composited = composite(density.view(t.shape), t, far)
    rgb = (composited.weights[..., None] * midpoints(colour.view(*t.shape, 3))).sum(dim=1) * rays.valid[:, None]
    signs = torch.randint(0, 2, rgb.shape, generator=generator).to(rgb) * 2 - 1
    (slope,) = torch.autograd.grad((signs * rgb).sum(), unit)
    error = float(((rgb.detach() - rays.rgb)[rays.valid] ** 2).mean())
    index, weight = _corners(unit.detach(), field.box.height, shape)
    slopes = torch.zeros(3, math.prod(shape), device=unit.device)
    for axis in range(3):
        slopes[axis].index_add_(0, index.view(-1), (weight * slope[:, axis, None]).view(-1))
    return slopes, error


def _vertices(height: float, across: int) -> tuple[int, int, int]:
    return max(2, math.ceil(height * (across - 1)) + 1), across, across


def _corners(unit: Tensor, height: float, shape: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Flat indices (n, 8) of the vertices around points (n, 3), and their trilinear weights."""
    nz, ny, nx = shape
    position = unit * unit.new_tensor([nx - 1, ny - 1, (nz - 1) / height])
    cell = torch.minimum(position.floor(), unit.new_tensor([nx - 2, ny - 2, nz - 2])).clamp(min=0)
    fraction = position - cell
    low = cell.long()
    index, weight = [], []
    for corner in range(8):
        up = [corner >> axis & 1 for axis in range(3)]
        x, y, z = (low[:, axis] + up[axis] for axis in range(3))
        index.append((z * ny + y) * nx + x)
        parts = [fraction[:, axis] if up[axis] else 1 - fraction[:, axis] for axis in range(3)]
        weight.append(parts[0] * parts[1] * parts[2])
    return torch.stack(index, dim=-1), torch.stack(weight, dim=-1)


def confidence(
    agreement: Array32, opacity: Array32, spread_px: Array32, bayes_px: Array32 | None, options: UncertaintyOptions
) -> Array32:
    """Confidence in [0, 1] per pixel: the product of one factor per input.

    Args:
        agreement: of the depth maps with the rendered surface, and of the number of photos, in [0, 1].
        opacity: total termination weight.
        spread_px: standard deviation of the termination depth, in pixels on the ground.
        bayes_px: standard deviation by Bayes' Rays, in pixels on the ground, or None.
    """
    result = agreement * np.clip(2 * opacity - 1, 0, 1) / (1 + (spread_px / options.spread_px) ** 2)
    if bayes_px is not None:
        result = result / (1 + (bayes_px / options.bayes_px) ** 2)
    return np.asarray(np.nan_to_num(np.clip(result, 0, 1)), dtype=np.float32)


def reliability(
    confidence: Array32, error: Array32, limit: float, *, bins: int = 5
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Reliability diagram of the confidence: share of pixels with |error| below `limit`, per bin of confidence.

    Pixels whose error is not finite are left out. Returns the mean confidence (bins,), the share (bins,), NaN for empty
    bins, and the number of pixels (bins,); the bins divide [0, 1] evenly.
    """
    known = np.isfinite(error) & np.isfinite(confidence)
    position = np.clip((confidence[known] * bins).astype(np.int64), 0, bins - 1)
    counts = np.bincount(position, minlength=bins)
    good = np.bincount(position, np.abs(error[known]) < limit, minlength=bins)
    total = np.bincount(position, confidence[known], minlength=bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / counts, good / counts, counts
