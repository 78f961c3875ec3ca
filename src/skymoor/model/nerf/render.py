# SPDX-License-Identifier: Apache-2.0
"""Orthographic views of a field, from coarse to fine.

The first pass samples the whole ray. Each following one has twice the resolution and samples only the depth range that
the pass before found near the same pixel, except at edges, where it samples the whole ray again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from skymoor.model.nerf.box import INNER_PER_LEVEL
from skymoor.model.nerf.field import Field
from skymoor.model.nerf.sampling import Proposal, composite, midpoints, sample_proposal
from skymoor.types import Array32, Camera, Progress, View

CHUNK_RAYS = 1 << 13
COARSEST_PX = 512


@dataclass(frozen=True, eq=False)
class Layers:
    """Values of a field per pixel (h, w): points (h, w, 3) of the inner frame at the median depth, colours (h, w, 3)
    in [0, 1], opacity, and the standard deviation of depth in inner units. `t` is the median depth along the ray."""

    xyz: Tensor
    rgb: Tensor
    opacity: Tensor
    spread: Tensor
    t: Tensor


@torch.no_grad()
def render_layers(field: Field, proposal: Proposal, view: View, progress: Progress) -> Layers:
    """Integrate along all rays of an orthographic view."""
    h, w = view.shape
    steps = max(0, int(np.ceil(np.log2(max(h, w) / COARSEST_PX))))
    coarse: Layers | None = None
    for level in range(steps, -1, -1):
        size = (-(-h // 2**level), -(-w // 2**level))
        origin, direction = _ortho_rays(field, view, size, 2**level)
        coarse = _pass(field, proposal, origin, direction, size, coarse)
        progress(steps - level + 1, steps + 1)
    assert coarse is not None
    return coarse


def _ortho_rays(field: Field, view: View, size: tuple[int, int], step: int) -> tuple[Tensor, Tensor]:
    """Origins (h * w, 3) just above the slab, and the direction (3,), of blocks of `step` by `step` pixels."""
    box, device = field.box, field.prior.device
    u, v = (np.arange(size[1]) + 0.5) * step, (np.arange(size[0]) + 0.5) * step
    x, y = np.meshgrid(view.x0 + u * view.pixel, view.y0 + v * view.pixel)
    level = np.stack([x, y, np.zeros_like(x)], axis=-1) @ view.view_from_level
    direction = view.view_from_level[2]
    inner = box.inner_from_level(level).reshape(-1, 3)
    if direction[2] < -1e-3:  # start on a plane a little above the ceiling
        inner = inner + ((box.high + 1 - inner[:, 2:]) / direction[2]) * direction
    return (
        torch.tensor(inner, dtype=torch.float32, device=device),
        torch.tensor(direction, dtype=torch.float32, device=device),
    )


def _pass(
    field: Field, proposal: Proposal, origin: Tensor, direction: Tensor, size: tuple[int, int], coarse: Layers | None
) -> Layers:
    device = origin.device
    near, far = field.box.span(origin, direction.expand_as(origin))
    valid = far > near
    low, high = near, far
    narrow = torch.zeros_like(valid)
    if coarse is not None:
        low, high, narrow = _local_range(coarse, size, origin, direction, near, far, field)
    n = len(origin)
    t, opacity, spread = torch.zeros(n, device=device), torch.zeros(n, device=device), torch.zeros(n, device=device)
    rgb = torch.zeros(n, 3, device=device)
    for mask, refine in ((valid & narrow, True), (valid & ~narrow, False)):
        for rows in torch.split(torch.nonzero(mask)[:, 0], CHUNK_RAYS):
            if not len(rows):  # split of an empty list
                continue
            rays = origin[rows], direction.expand(len(rows), 3)
            search = (low[rows], high[rows]) if refine else None
            t[rows], rgb[rows], opacity[rows], spread[rows] = integrate_rays(
                field, proposal, *rays, near[rows], far[rows], search
            )
    xyz = origin + t[:, None] * direction
    return Layers(*(x.view(*size, *x.shape[1:]) for x in (xyz, rgb, opacity, spread, t)))


def integrate_rays(
    field: Field,
    proposal: Proposal,
    origin: Tensor,
    direction: Tensor,
    near: Tensor,
    far: Tensor,
    search: tuple[Tensor, Tensor] | None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Median distance (n,), colour (n, 3), opacity (n,) and spread of distance (n,) of rays (n, 3).

    Samples lie between the two distances `search`, or are drawn by the proposal.
    """
    sizes, box = field.sizes, field.box
    if search is not None:
        even = torch.linspace(0, 1, sizes.refine_samples, device=near.device)
        t = search[0][:, None] + (search[1] - search[0])[:, None] * even
    else:
        weights = proposal.weights(origin, direction, near, far, sizes.bins)
        t = sample_proposal(weights, near, far, sizes.render_samples, None)
    unit = box.unit_from_inner((origin[:, None] + t[..., None] * direction[:, None]).view(-1, 3))
    density, colour = field(unit, direction.repeat_interleave(t.shape[1], 0))
    composited = composite(density.view(t.shape), t, far)
    normalised = composited.weights / composited.opacity.clamp(min=1e-6)[:, None]
    rgb = (normalised[..., None] * midpoints(colour.view(*t.shape, 3))).sum(dim=1)
    return composited.median, rgb, composited.opacity, composited.variance.sqrt()


def _local_range(
    coarse: Layers, size: tuple[int, int], origin: Tensor, direction: Tensor, near: Tensor, far: Tensor, field: Field
) -> tuple[Tensor, Tensor, Tensor]:
    """Nearest and farthest depth (n,) of the coarse pass around a pixel, with a margin, and whether that range is
    narrower than an edge.

    Rays of a view begin on one level plane, so that level ground has a constant depth in oblique views too.
    """
    cell = field.box.inner_per_unit / field.prior.shape[-1]
    image = torch.stack([coarse.t, -coarse.t, coarse.spread])[None]
    local_max = functional.max_pool2d(functional.pad(image, (1, 1, 1, 1), mode="replicate"), 3, 1)
    fine = functional.interpolate(local_max, scale_factor=2, mode="nearest")[0, :, : size[0], : size[1]].reshape(3, -1)
    margin = cell + fine[2]
    low, high = -fine[1] - margin, fine[0] + margin
    translucent = functional.max_pool2d((coarse.opacity < 0.9).float()[None, None], 3, 1, 1)
    translucent = (
        functional.interpolate(translucent, scale_factor=2, mode="nearest")[0, 0, : size[0], : size[1]].reshape(-1) > 0
    )
    narrow = (high - low < 6 * cell) & ~translucent
    return torch.maximum(low, near), torch.minimum(high, far), narrow


@torch.no_grad()
def z_buffer(proposal: Proposal, camera: Camera, reduce: int, bins: int) -> Array32:
    """z-depth of the proposal's surface in a photo, level units, at a part of its size; infinite where there is none.

    It is used for occlusion tests only, for which the densities of the grid are sufficient.
    """
    box, device = proposal.box, proposal.density.device
    i = camera.intrinsics
    small = i.resized(max(1, i.width // reduce), max(1, i.height // reduce))
    u, v = np.meshgrid(np.arange(small.width) + 0.5, np.arange(small.height) + 0.5)
    rays = small.rays(np.stack([u.ravel(), v.ravel()], axis=1)) @ camera.cam_from_world.rotation
    direction = torch.tensor(rays, dtype=torch.float32, device=device)
    origin = torch.tensor(box.inner_from_level(camera.centre), dtype=torch.float32, device=device)
    parts = []
    for part in torch.split(direction, CHUNK_RAYS):
        start = origin.expand_as(part)
        near, far = box.span(start, part)
        valid = far > near
        far = torch.where(valid, far, near + 1)
        weights = proposal.weights(start, part, near, far, bins)
        terminated = torch.cumsum(weights, dim=-1) > 0.5
        first = terminated.float().argmax(dim=-1)
        z = near + (first + 0.5) / bins * (far - near)
        parts.append(torch.where(valid & terminated.any(dim=-1), z, torch.inf))
    depth = torch.cat(parts).view(small.height, small.width) / INNER_PER_LEVEL
    return np.asarray(depth.cpu().numpy(), dtype=np.float32)
