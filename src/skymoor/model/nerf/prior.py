# SPDX-License-Identifier: Apache-2.0
"""Prior on density from the depth maps, before training.

On a CPU the training uses a fraction of all pixels, and most of the accuracy comes from the initial field. Each depth
map votes for each cell of a grid: free space or surface; no vote if the cell is behind its surface. The mean signed
distance of the votes locates the surface between cells, as in a truncated signed distance volume (Curless and Levoy
1996).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from skymoor.model.nerf.box import INNER_PER_LEVEL, RIM, Box
from skymoor.model.nerf.options import PriorOptions
from skymoor.types import DepthMap, Progress

BASE_LOG_DENSITY = -3.5  # of an untrained field, per inner unit: low enough for the slab to be transparent
CHUNK_CELLS = 1 << 19


@dataclass(frozen=True, eq=False)
class Votes:
    """Votes per cell (nz, ny, nx): number of depth maps for free space and for surface, and the sum of their signed
    distances in cells, positive in front of the surface, truncated at the width of the band."""

    free: Tensor
    surface: Tensor
    distance: Tensor


def grid_shape(box: Box, pixel_inner: float, options: PriorOptions) -> tuple[int, int, int]:
    """Cells (nz, ny, nx) of the prior; `pixel_inner` is a photo's pixel on the ground."""
    side = 2 * (1 + RIM) * box.half
    across = min(options.max_cells_across, math.ceil(side / (options.cell_px * pixel_inner)))
    return max(4, math.ceil((box.high - box.low) / side * across)), max(4, across), max(4, across)


def cell_centres(box: Box, shape: tuple[int, int, int], flat: Tensor) -> Tensor:
    """Unit coordinates (n, 3) of the cells with flat index (n,)."""
    nz, ny, nx = shape
    x, y = flat % nx, torch.div(flat, nx, rounding_mode="floor") % ny
    z = torch.div(flat, nx * ny, rounding_mode="floor")
    return torch.stack([(x + 0.5) / nx, (y + 0.5) / ny, (z + 0.5) / nz * box.height], dim=-1)


def cast_votes(
    maps: Sequence[DepthMap],
    box: Box,
    shape: tuple[int, int, int],
    options: PriorOptions,
    device: torch.device,
    progress: Progress,
) -> Votes:
    """Votes of all depth maps for all cells of the grid."""
    cell = box.inner_per_unit / shape[2]
    views = [_View(depth_map, box, options, device) for depth_map in maps]
    total = math.prod(shape)
    free, surface, distance = (torch.zeros(total, device=device) for _ in range(3))
    for start in range(0, total, CHUNK_CELLS):
        flat = torch.arange(start, min(start + CHUNK_CELLS, total), device=device)
        centres = box.inner_from_unit(cell_centres(box, shape, flat))
        scale = box.stretch(centres)[:, 0] / box.inner_per_unit * cell
        part = slice(start, start + len(flat))
        for view in views:
            gap = view.gap(centres) / scale
            known = gap > -options.band_cells  # not NaN
            gap = torch.where(known, gap.clamp(max=options.band_cells), torch.zeros_like(gap))
            at_surface = known & (gap < options.band_cells)
            free[part] += (known & ~at_surface).float()
            surface[part] += at_surface.float()
            distance[part] += gap
        progress(min(start + CHUNK_CELLS, total), total)
    return Votes(free.view(shape), surface.view(shape), distance.view(shape))


class _View:
    """A depth map on the device, for votes."""

    def __init__(self, depth_map: DepthMap, box: Box, options: PriorOptions, device: torch.device) -> None:
        camera, i = depth_map.camera, depth_map.camera.intrinsics
        with np.errstate(invalid="ignore"):
            certain = depth_map.sigma < options.max_sigma_ratio * depth_map.depth
        depth = np.where(certain, depth_map.depth * INNER_PER_LEVEL, np.nan).astype(np.float32)
        self._depth = torch.from_numpy(depth).to(device).view(-1)
        self._size = (i.width, i.height)
        matrix = i.matrix() @ camera.cam_from_world.rotation
        self._px_from_inner = torch.tensor(matrix, dtype=torch.float32, device=device)
        self._centre = torch.tensor(box.inner_from_level(camera.centre), dtype=torch.float32, device=device)

    def gap(self, xyz: Tensor) -> Tensor:
        """Depth of the surface minus the depth of points (n, 3), NaN where unknown."""
        u, v, z = ((xyz - self._centre) @ self._px_from_inner.T).unbind(dim=-1)
        width, height = self._size
        column, row = (u / z).long(), (v / z).long()
        inside = (z > 0) & (u > 0) & (v > 0) & (column < width) & (row < height)
        index = torch.where(inside, row * width + column, torch.zeros_like(row))
        nothing = torch.full_like(z, float("nan"))
        return torch.where(inside, self._depth[index] - z, nothing)


def log_density_prior(votes: Votes, cell: float, options: PriorOptions) -> Tensor:
    """Offset (nz, ny, nx) of the logarithm of a field's density, to be interpolated linearly.

    `cell` is the edge of a cell in inner units.

    Free space needs more than three votes, and four times as many as for surface; a cell next to a surface is not free.
    At a surface the prior grows by `slope` per cell such that an untrained field has its median depth there: with
    density s exp(s t), transmittance is 1/2 where density is s ln 2.
    """
    free, surface = votes.free, votes.surface
    votes_total = (free + surface).clamp(min=1)
    depth = -votes.distance / votes_total  # in cells, positive behind the surface
    level = math.log(math.log(2) * options.slope / cell) - BASE_LOG_DENSITY
    ramp = (level + options.slope * depth).clamp(options.free, level + options.slope)
    weight = (surface / 2).clamp(max=1)  # a single depth map may be wrong
    prior = torch.where(surface > 0, options.unknown + weight * (ramp - options.unknown), options.unknown)
    empty = (free > 3) & (free > 4 * surface)
    near = functional.max_pool3d(((surface > 0) & ~empty).float()[None, None], 3, 1, 1)[0, 0] > 0
    prior = torch.where(empty & ~near, torch.full_like(prior, options.free), prior)
    # Next to a surface free cells keep the value of their distance, so that the ramp is linear between cells.
    return torch.where(empty & near, ramp, prior)
