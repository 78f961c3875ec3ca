# SPDX-License-Identifier: Apache-2.0
"""The slab: contraction, rays and the part of the ground that photos cover."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from skymoor.errors import DegenerateGeometry
from skymoor.model.nerf.box import RIM, Box, make_box

BOX = Box((0.3, -0.2), 60.0, -4.0, 20.0)


def test_contraction_keeps_cubes_and_is_finite() -> None:
    inside = torch.tensor([[0.0, 0.0, -4.0], [60.0, 0.0, 20.0], [0.0, -30.0, 8.0]])
    unit = BOX.unit_from_inner(inside)
    side = 2 * (1 + RIM) * 60
    expected = torch.tensor([[0.5, 0.5, 0.0], [0.5 + 60 / side, 0.5, 24 / side], [0.5, 0.5 - 30 / side, 12 / side]])
    torch.testing.assert_close(unit, expected)
    far = BOX.unit_from_inner(torch.tensor([[1e7, 5e6, 0.0], [-1e9, 0.0, 0.0]]))
    assert (far[:, 0] - torch.tensor([1.0, 0.0])).abs().max() < 1e-4


def test_contraction_round_trip() -> None:
    generator = torch.Generator().manual_seed(0)
    xyz = (torch.rand(500, 3, generator=generator) - 0.5) * torch.tensor([900.0, 900.0, 0.0])
    xyz[:, 2] = torch.rand(500, generator=generator) * 24 - 4
    back = BOX.inner_from_unit(BOX.unit_from_inner(xyz))
    torch.testing.assert_close(back, xyz, rtol=2e-3, atol=2e-2)


def test_stretch_is_the_contractions_slope() -> None:
    for x in (20.0, 100.0, 200.0):
        xyz = torch.tensor([[x, 0.3 * x, 5.0]], requires_grad=True)
        step = torch.autograd.grad(BOX.unit_from_inner(xyz)[0, 0], xyz)[0][0, 0]
        stretch = BOX.stretch(xyz.detach())[0]
        assert stretch[0].item() * step.item() == pytest.approx(1.0, rel=1e-3)
        assert stretch[2].item() == pytest.approx(BOX.inner_per_unit)


def test_coordinates_that_are_no_numbers_do_no_harm() -> None:
    nan, inf = float("nan"), float("inf")
    unit = BOX.unit_from_inner(torch.tensor([[nan, 0.0, 0.0], [inf, 0.0, nan]]))
    assert torch.isfinite(unit).all()
    assert ((unit >= 0) & (unit <= 1)).all()


def test_rays_cross_the_slab() -> None:
    s = 2**-0.5
    directions = torch.tensor([[0.0, 0.0, -1.0], [s, 0.0, -s], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, -0.01]])
    origins = torch.tensor([[0.0, 0.0, 100.0]]).expand(5, 3)
    near, far = BOX.span(origins, directions)
    assert (near[0].item(), far[0].item()) == pytest.approx((80.0, 104.0))
    assert (near[1].item(), far[1].item()) == pytest.approx((80 / s, 104 / s))
    assert not (far > near)[2:4].any()
    assert far[4] - near[4] == pytest.approx(6 * 60.0)  # a flat ray ends somewhere


def test_frames_are_inverse() -> None:
    level = np.array([[0.3, -0.2, 0.0], [1.3, 0.8, 0.1]])
    inner = BOX.inner_from_level(level)
    np.testing.assert_allclose(inner, [[0, 0, 0], [100, 100, 10]], atol=1e-9)
    np.testing.assert_allclose(BOX.level_from_inner(inner), level, atol=1e-12)


def test_box_of_points() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.5, -0.3, 0.0], [0.7, 0.3, 0.12], (20000, 3))
    box = make_box(points, margin=2.0)
    assert box.middle_level == pytest.approx((0.1, 0.0), abs=0.01)
    assert box.half == pytest.approx(60.0, rel=0.03)
    assert (box.low, box.high) == pytest.approx((-2.0, 14.0), abs=0.2)


def test_points_on_a_pole_make_no_box() -> None:
    with pytest.raises(DegenerateGeometry):
        make_box(np.column_stack([np.zeros(200), np.zeros(200), np.linspace(0, 1, 200)]))
