# SPDX-License-Identifier: Apache-2.0
"""The prior: who votes what, and where that puts the surface before any training."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from model.nerf.toy import PIXEL, Toy
from skymoor.model.nerf import PriorOptions
from skymoor.model.nerf.box import INNER_PER_LEVEL, Box
from skymoor.model.nerf.prior import BASE_LOG_DENSITY, Votes, cast_votes, grid_shape, log_density_prior
from skymoor.model.nerf.sampling import composite
from skymoor.types import DepthMap, no_progress

OPTIONS = PriorOptions(cell_px=2.0)
BOX = Box((0.0, 0.0), 40.0, -3.0, 13.0)
CELL = BOX.inner_per_unit / grid_shape(BOX, PIXEL * INNER_PER_LEVEL, OPTIONS)[2]


def votes_of(maps: list[DepthMap]) -> Votes:
    shape = grid_shape(BOX, PIXEL * INNER_PER_LEVEL, OPTIONS)
    return cast_votes(maps, BOX, shape, OPTIONS, torch.device("cpu"), no_progress)


def column(grid: torch.Tensor, x: float, y: float) -> torch.Tensor:
    """Values upwards over a plan position in inner units."""
    unit = BOX.unit_from_inner(torch.tensor([x, y, 0.0]))
    return grid[:, int(unit[1] * grid.shape[1]), int(unit[0] * grid.shape[2])]


def heights_of(grid: torch.Tensor) -> torch.Tensor:
    return BOX.low + (torch.arange(grid.shape[0]) + 0.5) / grid.shape[0] * (BOX.high - BOX.low)


def test_cells_are_cubes_of_the_wanted_size() -> None:
    nz, ny, nx = grid_shape(BOX, 1.2, OPTIONS)
    assert nx == ny == math.ceil(BOX.inner_per_unit / 2.4)
    assert (BOX.high - BOX.low) / nz == pytest.approx(BOX.inner_per_unit / nx, rel=0.15)
    assert grid_shape(BOX, 0.001, OPTIONS)[2] == OPTIONS.max_cells_across


def test_air_is_free_and_the_ground_is_solid(toy: Toy) -> None:
    votes = votes_of(toy.exact)
    prior = log_density_prior(votes, CELL, OPTIONS)
    heights = heights_of(prior)
    air = column(prior, 30.0, 0.0)[heights > 3 * CELL]
    assert (air == OPTIONS.free).all()
    assert column(prior, 30.0, 0.0)[heights < 0].min() > 2
    # Inside the box nothing was seen, on its roof all agree.
    inside = column(votes.free + votes.surface, 0.0, 0.0)[(heights > -1) & (heights < 2)]
    assert not inside.any()
    assert (column(prior, 0.0, 0.0)[(heights > -1) & (heights < 2)] == OPTIONS.unknown).all()
    assert column(prior, 0.0, 0.0)[(heights > 6) & (heights < 9.5)].max() > 2


@pytest.mark.parametrize(("x", "height"), [(30.0, 0.0), (0.0, 10.0)])
def test_the_surface_lies_between_cells_where_it_was_measured(toy: Toy, x: float, height: float) -> None:
    prior = log_density_prior(votes_of(toy.exact), CELL, OPTIONS)
    values, heights = column(prior, x, 0.0), heights_of(prior)
    t = torch.linspace(0.0, 12.0, 400)
    found = np.interp((height + 6 - t.numpy()), heights.numpy(), values.numpy())
    density = torch.exp(torch.tensor(found[None], dtype=torch.float32) + BASE_LOG_DENSITY)
    composited = composite(density, t[None], torch.tensor([12.0]))
    assert composited.median.item() == pytest.approx(6.0, abs=0.15 * CELL)


def test_one_wrong_depth_map_carves_no_hole(toy: Toy) -> None:
    right = log_density_prior(votes_of(toy.exact), CELL, OPTIONS)
    far = replace(toy.exact[8], depth=(1.3 * toy.exact[8].depth).astype(np.float32))
    fooled = log_density_prior(votes_of([*toy.exact[:8], far, *toy.exact[9:]]), CELL, OPTIONS)
    solid = (right > 3).sum()
    assert ((right > 3) & (fooled < -3)).sum() < 0.01 * solid


def test_votes_that_look_through_need_a_majority() -> None:
    free = torch.tensor([3.0, 4.0, 9.0, 8.0, 0.0])
    surface = torch.tensor([0.0, 0.0, 2.0, 2.0, 0.0])
    distance = 2.5 * free
    grid = Votes(*(x.view(1, 1, 5).repeat_interleave(3, dim=2) for x in (free, surface, distance)))
    prior = log_density_prior(grid, 1.0, OPTIONS)[0, 0, 1::3]
    assert prior[0] == OPTIONS.unknown  # three are not enough
    assert prior[1] == OPTIONS.free
    assert prior[4] == OPTIONS.unknown
    assert prior[2] <= prior[3]


def test_uncertain_depths_do_not_vote(toy: Toy) -> None:
    unsure = [replace(m, sigma=(0.05 * m.depth).astype(np.float32)) for m in toy.exact]
    votes = votes_of(unsure)
    assert not votes.free.any()
    assert not votes.surface.any()
