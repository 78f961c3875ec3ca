# SPDX-License-Identifier: Apache-2.0
"""The hash encoding: interpolation, and a gradient that is right on average."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from skymoor.model.nerf import Sizes
from skymoor.model.nerf.hashgrid import HashGrid

SIZES = Sizes(levels=4, base_cells=4, features=3, table_log2=9, finest_table_log2=10)
HEIGHT = 0.25


def make_grid(finest_cells: int = 40) -> HashGrid:
    return HashGrid(SIZES, finest_cells, HEIGHT, torch.Generator().manual_seed(0))


def points(count: int, seed: int = 1) -> torch.Tensor:
    xyz = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))
    return xyz * torch.tensor([1.0, 1.0, HEIGHT])


def test_levels_that_fit_are_not_hashed() -> None:
    grid = make_grid()
    assert grid.scale.tolist() == [4, 8, 18, 40]
    # 6 * 6 * 3 and 10 * 10 * 4 entries, then tables of 2^9 and 2^10.
    assert grid.dense == 2
    assert grid.table.shape == (108 + 400 + 512 + 1024, 3)
    assert grid.finest_first == 108 + 400 + 512


def test_a_linear_function_is_interpolated_exactly() -> None:
    grid = make_grid()
    z, y, x = np.meshgrid(np.arange(3), np.arange(6), np.arange(6), indexing="ij")
    values = 2 * x - 3 * y + 5 * z
    with torch.no_grad():
        grid.table[:108, 0] = torch.tensor(values.ravel(), dtype=torch.float32)
    xyz = points(200)
    found = grid(xyz)[:, 0]
    expected = 4 * (2 * xyz[:, 0] - 3 * xyz[:, 1] + 5 * xyz[:, 2])
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)


def test_all_rows_are_in_the_table_at_the_borders() -> None:
    grid = make_grid()
    corners = torch.cartesian_prod(*[torch.tensor([0.0, limit]) for limit in (1.0, 1.0, HEIGHT)])
    index, weights, _ = grid._eager_corners(torch.cat([corners, points(2000)]))
    last = torch.cat([grid.offset[1:] - 1, torch.tensor([len(grid.table) - 1])])
    assert (index >= grid.offset[:, None]).all()
    assert (index <= last[:, None]).all()
    torch.testing.assert_close(weights.sum(dim=-1), torch.ones_like(weights[..., 0]))


def test_one_corner_has_the_exact_gradient_on_average() -> None:
    grid, xyz = make_grid(), points(40)
    wanted = torch.randn(40, grid.width, generator=torch.Generator().manual_seed(2))
    (grid(xyz) * wanted).sum().backward()
    assert grid.table.grad is not None
    exact = grid.table.grad.clone()
    generator, rounds = torch.Generator().manual_seed(3), 3000
    total, one = torch.zeros_like(exact), torch.zeros_like(exact)
    for _ in range(rounds):
        grid.table.grad.zero_()
        (grid(xyz, torch.rand(40, 3, generator=generator)) * wanted).sum().backward()
        one = grid.table.grad.clone()
        total += one
    # One draw is far off, the mean of many is not: its error falls with the root of their number.
    scale = exact.norm()
    assert (one - exact).norm() > 0.5 * scale
    assert (total / rounds - exact).norm() < 0.05 * scale


def test_one_corner_gives_each_level_its_whole_gradient() -> None:
    grid, xyz = make_grid(), points(1)
    grid(xyz, torch.rand(1, 3)).sum().backward()
    assert grid.table.grad is not None
    assert (grid.table.grad.sum(dim=0) == SIZES.levels).all()
    assert (grid.table.grad.abs().sum(dim=1) > 0).sum() <= SIZES.levels


def test_values_are_the_same_with_and_without_draws() -> None:
    grid, xyz = make_grid(), points(100)
    torch.testing.assert_close(grid(xyz, torch.rand(100, 3)), grid(xyz))


def test_gradient_of_the_points_is_that_of_the_interpolation() -> None:
    grid = make_grid()
    with torch.no_grad():
        grid.table.normal_(generator=torch.Generator().manual_seed(4))
    # Away from the cells' borders, where the slope jumps.
    cell = torch.tensor([[0.37, 0.61, 0.13]])
    xyz = cell.clone().requires_grad_()
    (slope,) = torch.autograd.grad(grid(xyz).sum(), xyz)
    step = 1e-3
    for axis in range(3):
        shift = torch.zeros(1, 3)
        shift[0, axis] = step
        numeric = (grid(cell + shift).sum() - grid(cell - shift).sum()) / (2 * step)
        assert slope[0, axis].item() == pytest.approx(numeric.item(), rel=0.02, abs=0.05)


def test_without_a_compiler_the_look_up_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> object:
        def fail(*_: object) -> object:
            raise RuntimeError("no compiler here")

        return fail

    grid, xyz = make_grid(), points(20)
    before = grid(xyz)
    monkeypatch.setattr(torch, "compile", broken)
    grid.compile_look_up()
    torch.testing.assert_close(grid(xyz), before, rtol=0, atol=0)
