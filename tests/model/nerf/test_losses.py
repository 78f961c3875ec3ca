# SPDX-License-Identifier: Apache-2.0
"""Losses: values worked out by hand, and gradients that point the right way."""

from __future__ import annotations

import math

import pytest
import torch

from skymoor.model.nerf.losses import (
    depth_loss,
    distortion_loss,
    line_of_sight_loss,
    opacity_loss,
    photometric_loss,
    ranking_loss,
)
from skymoor.model.nerf.sampling import composite

NAN = float("nan")


def slope(loss: torch.Tensor, of: torch.Tensor) -> torch.Tensor:
    return torch.autograd.grad(loss, of)[0]


def test_photometric_is_quadratic_then_linear() -> None:
    target = torch.zeros(1, 3)
    assert photometric_loss(target, target).item() == 0
    small, large = (photometric_loss(torch.full((1, 3), x), target).item() for x in (0.005, 0.8))
    assert small == pytest.approx(0.005**2 / (2 * 0.05), rel=0.01)
    assert large == pytest.approx(0.8 - 0.05, rel=0.01)


def test_photometric_pulls_towards_the_target() -> None:
    rgb = torch.tensor([[0.2, 0.5, 0.9]], requires_grad=True)
    gradient = slope(photometric_loss(rgb, torch.full((1, 3), 0.5)), rgb)
    assert gradient[0, 0] < 0 < gradient[0, 2]
    assert gradient[0, 1] == 0


def test_depth_is_the_cross_entropy_with_the_measured_distribution() -> None:
    # Two intervals that meet at the measured depth hold a half of it each.
    edges, depth = torch.tensor([[0.0, 10.0, 20.0]]), torch.tensor([10.0])
    weights = torch.tensor([[0.3, 0.6]])
    expected = -0.5 * (math.log(0.31) + math.log(0.61))
    assert depth_loss(weights, edges, depth, torch.tensor([0.5])).item() == pytest.approx(expected, rel=1e-5)


def test_depth_expects_its_standard_deviation() -> None:
    # A weight of exp(-x) makes the loss the mean of x under the target: take the distance and its square.
    edges = torch.linspace(-13.0, 5.0, 6001, dtype=torch.float64)[None]
    gap = (edges[:, 1:] + edges[:, :-1]) / 2
    depth, sigma = torch.zeros(1, dtype=torch.float64), torch.full((1,), 1.5, dtype=torch.float64)
    mean, square = (depth_loss(torch.exp(-x), edges, depth, sigma, floor=0.0).item() for x in (gap, gap**2))
    assert math.sqrt(square - mean**2) == pytest.approx(1.5, rel=0.01)
    # The median is the measured depth, the long tail before it draws the mean nearer.
    assert -0.5 < mean < -0.2


def test_depth_is_least_for_a_straight_logarithm_of_density() -> None:
    t = torch.linspace(0.0, 20.0, 401)[None]
    losses = []
    for shift in (-0.5, 0.0, 0.5):
        composited = composite(1.2 * torch.exp(1.2 * (t - 10 - shift) + math.log(math.log(2))), t, torch.tensor([20.0]))
        sigma = torch.tensor([math.pi / math.sqrt(6) / 1.2])
        losses.append(depth_loss(composited.weights, composited.edges, torch.tensor([10.0]), sigma, floor=1e-9).item())
    assert losses[1] < min(losses[0], losses[2]) - 0.05


def test_depth_draws_light_to_the_measured_place() -> None:
    edges = torch.tensor([[0.0, 4.0, 6.0, 20.0]])
    weights = torch.full((1, 3), 0.3, requires_grad=True)
    gradient = slope(depth_loss(weights, edges, torch.tensor([5.0]), torch.tensor([0.3])), weights)[0]
    assert gradient[1] < -1
    assert gradient[[0, 2]].abs().max() < 0.05


@pytest.mark.parametrize("loss", [depth_loss, line_of_sight_loss])
def test_rays_without_depth_do_not_count(loss: object) -> None:
    t, edges = torch.tensor([[1.0, 3.0], [1.0, 3.0]]), torch.tensor([[0.0, 2.0, 4.0]]).expand(2, 3)
    weights = torch.tensor([[0.7, 0.2], [0.4, 0.6]], requires_grad=True)
    depth, sigma = torch.tensor([3.0, NAN]), torch.tensor([0.1, NAN])
    place = edges if loss is depth_loss else t
    both = loss(weights, place, depth, sigma)  # type: ignore[operator]
    alone = loss(weights[:1], place[:1], depth[:1], sigma[:1])  # type: ignore[operator]
    assert both.item() == pytest.approx(alone.item(), rel=1e-6)
    assert both.item() > 0.1
    gradient = slope(both, weights)
    assert torch.isfinite(gradient).all()
    assert not gradient[1].any()
    nothing = loss(weights, place, torch.full((2,), NAN), torch.full((2,), NAN))  # type: ignore[operator]
    assert nothing.item() == 0


def test_line_of_sight_counts_what_ends_three_sigmas_early() -> None:
    t = torch.tensor([[1.0, 8.4, 8.6, 10.0, 12.0]])
    weights = torch.tensor([[0.1, 0.2, 0.3, 0.2, 0.1]], requires_grad=True)
    loss = line_of_sight_loss(weights, t, torch.tensor([10.0]), torch.tensor([0.5]))
    assert loss.item() == pytest.approx(0.3**2, rel=1e-5)  # 1.0 and 8.4 lie before 8.5
    gradient = slope(loss, weights)[0]
    assert (gradient[:2] > 0).all()
    assert not gradient[2:].any()


def test_distortion_is_the_double_sum() -> None:
    generator = torch.Generator().manual_seed(3)
    weights = torch.rand(4, 6, generator=generator)
    edges = torch.rand(4, 7, generator=generator).cumsum(dim=1)
    t = (edges[:, 1:] + edges[:, :-1]) / 2
    pairs = (weights[:, :, None] * weights[:, None] * (t[:, :, None] - t[:, None]).abs()).sum(dim=(1, 2))
    expected = (pairs + (weights**2 * edges.diff(dim=1)).sum(dim=1) / 3).mean() / 10
    assert distortion_loss(weights, t, edges).item() == pytest.approx(expected.item(), rel=1e-5)


def test_distortion_draws_light_together() -> None:
    t, edges = torch.tensor([[1.0, 2.0, 9.0]]), torch.tensor([[0.9, 1.1, 2.1, 9.1]])
    weights = torch.tensor([[0.45, 0.45, 0.1]], requires_grad=True)
    gradient = slope(distortion_loss(weights, t, edges), weights)[0]
    assert gradient[2] > 3 * gradient[:2].max() > 0


def test_opacity_asks_only_rays_that_must_end() -> None:
    opacity = torch.tensor([0.25, 0.5], requires_grad=True)
    loss = opacity_loss(opacity, torch.tensor([True, False]))
    assert loss.item() == pytest.approx(0.75**2)
    gradient = slope(loss, opacity)
    assert gradient[0] < 0 == gradient[1]


def test_ranking_of_pairs() -> None:
    relative = torch.tensor([[0.1, 0.9], [0.1, 0.9], [0.9, 0.1], [0.5, 0.5], [0.1, 0.9]])
    depth = torch.tensor([[5.0, 6.0], [6.0, 5.0], [5.0, 6.0], [5.0, 9.0], [6.0, 5.0]], requires_grad=True)
    counts = torch.tensor([True, True, True, True, False])
    loss = ranking_loss(depth, relative, counts, margin=0.25)
    # The first is right, two are wrong by 1, the fourth has no order, the fifth does not count.
    assert loss.item() == pytest.approx((0 + 1.25 + 1.25) / 3)
    gradient = slope(loss, depth)
    assert gradient[1, 0] > 0 > gradient[1, 1]
    assert gradient[2, 0] < 0 < gradient[2, 1]
    assert not gradient[[0, 3, 4]].any()


def test_ranking_without_monocular_depth_is_nothing() -> None:
    depth = torch.tensor([[5.0, 6.0]], requires_grad=True)
    loss = ranking_loss(depth, torch.full((1, 2), NAN), torch.tensor([True]), margin=0.25)
    assert loss.item() == 0
