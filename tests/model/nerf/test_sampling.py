# SPDX-License-Identifier: Apache-2.0
"""Samples along rays, and what rays see of densities whose answer is known."""

from __future__ import annotations

import math

import pytest
import torch

from skymoor.model.nerf.box import Box
from skymoor.model.nerf.sampling import Proposal, composite, midpoints, ray_weights, sample_measured, sample_proposal

BOX = Box((0.0, 0.0), 50.0, -5.0, 25.0)


def test_constant_density_lets_light_fade_exponentially() -> None:
    edges = torch.linspace(0.0, 8.0, 17)[None]
    weights, optical = ray_weights(torch.full((1, 16), 0.5), edges.diff(dim=1))
    expected = torch.exp(-0.5 * edges[:, :-1]) - torch.exp(-0.5 * edges[:, 1:])
    torch.testing.assert_close(weights, expected, rtol=1e-5, atol=1e-6)
    assert optical[0, -1].item() == pytest.approx(4.0, rel=1e-5)


def test_median_depth_is_exact_between_samples() -> None:
    t, far = torch.linspace(2.0, 22.0, 7)[None], torch.tensor([30.0])
    for density in (0.15, 0.6, 3.0):
        composited = composite(torch.full((1, 7), density), t, far)
        assert composited.median.item() == pytest.approx(2.0 + math.log(2) / density, rel=1e-4)


@pytest.mark.parametrize("count", [9, 33])
def test_density_that_grows_exponentially_is_integrated_exactly(count: int) -> None:
    # s exp(s (t - 10)) has collected exp(s (t - 10)) by t: half of the light is gone at 10 + ln(ln 2) / s.
    s = 1.5
    t = torch.linspace(0.0, 16.0, count)[None]
    composited = composite(s * torch.exp(s * (t - 10)), t, torch.tensor([20.0]))
    assert composited.median.item() == pytest.approx(10 + math.log(math.log(2)) / s, abs=1e-3)
    assert composited.opacity.item() == pytest.approx(1.0, abs=1e-5)


def test_falling_density_is_integrated_exactly() -> None:
    t = torch.linspace(0.0, 12.0, 5)[None]
    composited = composite(2.0 * torch.exp(-0.5 * t), t, torch.tensor([12.0]))
    assert composited.opacity.item() == pytest.approx(1 - math.exp(-4 * (1 - math.exp(-6))), rel=1e-4)
    assert composited.median.item() == pytest.approx(-2 * math.log(1 - math.log(2) / 4), rel=1e-3)


def test_a_wall_is_seen_where_it_begins() -> None:
    t = torch.linspace(0.0, 20.0, 41)[None]
    composited = composite(torch.where(t > 12.0, 50.0, 0.0), t, torch.tensor([21.0]))
    assert 12.0 < composited.median.item() < 12.6
    assert composited.opacity.item() == pytest.approx(1.0, abs=1e-5)
    assert composited.variance.sqrt().item() < 0.3


def test_two_half_transparent_layers_have_a_spread() -> None:
    t = torch.linspace(0.0, 20.0, 41)[None]
    density = torch.where((t > 4) & (t < 5.1), 0.6, 0.0) + torch.where(t > 14, 50.0, 0.0)
    composited = composite(density, t, torch.tensor([20.0]))
    assert composited.opacity.item() == pytest.approx(1.0, abs=1e-4)
    assert 4.5 < composited.variance.sqrt().item() < 10.0


def test_thin_air_is_not_opaque() -> None:
    t = torch.linspace(0.0, 18.0, 20)[None]
    composited = composite(torch.full((1, 20), 0.01), t, torch.tensor([20.0]))
    assert composited.opacity.item() == pytest.approx(1 - math.exp(-0.2), rel=1e-4)
    assert torch.isfinite(composited.median).all()


def test_the_gradient_of_an_opaque_ray_is_a_number() -> None:
    raw = torch.tensor([[-30.0, -3.0, 8.0, 8.0, -30.0]], requires_grad=True)
    composited = composite(raw.exp(), torch.tensor([[1.0, 2.0, 3.0, 3.0, 9.0]]), torch.tensor([12.0]))
    (slope,) = torch.autograd.grad(composited.mean.sum() + torch.log(composited.weights + 0.01).sum(), raw)
    assert torch.isfinite(slope).all()
    assert slope.abs().max() > 0


def test_values_of_intervals_lie_between_those_of_samples() -> None:
    values = torch.tensor([[[1.0], [3.0], [7.0]]])
    assert midpoints(values).flatten().tolist() == [2.0, 5.0, 7.0]


def test_samples_follow_the_weights() -> None:
    weights = torch.zeros(1, 64)
    weights[0, 40] = 1.0
    t = sample_proposal(weights, torch.tensor([10.0]), torch.tensor([74.0]), 100, None)[0]
    assert (t.diff() > 0).all()
    near_bin = (t >= 10 + 39) & (t <= 10 + 42)  # the bin and its neighbours
    assert 0.95 < near_bin.float().mean().item() < 1.0  # the rest is the floor


def test_samples_of_even_weights_are_even() -> None:
    t = sample_proposal(torch.ones(1, 8), torch.tensor([0.0]), torch.tensor([16.0]), 4, None)
    torch.testing.assert_close(t, torch.tensor([[2.0, 6.0, 10.0, 14.0]]), rtol=1e-4, atol=1e-4)


def test_jitter_stays_in_its_share() -> None:
    jitter = torch.rand(500, 4, generator=torch.Generator().manual_seed(0))
    t = sample_proposal(torch.ones(500, 8), torch.zeros(500), torch.full((500,), 16.0), 4, jitter)
    share = torch.div(t, 4.0, rounding_mode="floor")
    assert (share == torch.arange(4)).all()
    assert t.std(dim=0).min() > 1.0


def test_measured_depths_draw_samples() -> None:
    t = torch.linspace(0.5, 99.5, 10).expand(2000, 10)
    depth = torch.full((2000,), 40.0)
    depth[1000:] = float("nan")
    normal = torch.randn(2000, 6, generator=torch.Generator().manual_seed(1))
    mixed = sample_measured(t, depth, torch.full((2000,), 0.5), normal)
    assert (mixed.diff(dim=1) >= 0).all()
    close = (mixed[:1000] - 40).abs() < 3
    assert (close.sum(dim=1) >= 6).all()
    assert 0.4 < (mixed[:1000] - 40)[close].std().item() < 0.6
    torch.testing.assert_close(mixed[1000:], t[1000:])


def test_the_proposal_finds_a_floor() -> None:
    density = torch.zeros(30, 20, 20)
    density[:5] = 5.0  # cells of one unit: up to height 0
    proposal = Proposal(BOX, density)
    origin, down = torch.tensor([[3.0, 4.0, 100.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    near, far = BOX.span(origin, down)
    assert (near.item(), far.item()) == pytest.approx((75.0, 105.0))
    weights = proposal.weights(origin, down, near, far, 60)
    place = weights.argmax().item()
    assert 75 + place * 0.5 == pytest.approx(100.0)
    assert weights.sum().item() == pytest.approx(1.0, abs=1e-4)


def test_updates_move_only_their_cells() -> None:
    proposal = Proposal(BOX, torch.zeros(30, 20, 20))
    unit = BOX.unit_from_inner(torch.tensor([[1.0, 1.0, 3.2]]))
    for _ in range(60):
        proposal.update(unit, torch.tensor([8.0]), rate=0.1)
    assert proposal.look_up(unit).item() == pytest.approx(8.0 * (1 - 0.9**60), rel=1e-3)
    assert (proposal.density > 0).sum() == 1
