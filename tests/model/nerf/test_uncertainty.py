# SPDX-License-Identifier: Apache-2.0
"""Uncertainty: what photos cannot tell is uncertain, and confidence falls with every check against."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from model.nerf.toy import Toy, component_of, down_view
from skymoor.model.nerf import UncertaintyOptions
from skymoor.model.nerf.uncertainty import Deformation, confidence, reliability

OPTIONS = UncertaintyOptions()
ASKED = UncertaintyOptions(rays=8192, cells_across=32)
NADIR = torch.tensor([0.0, 0.0, -1.0])


def bayes_sigma(toy: Toy, *, plain: bool) -> tuple[float, float]:
    """Median standard deviation along the vertical of the ground left and right of the box, inner units."""
    maps = toy.exact
    if plain:  # the ground at the right is without texture
        u, v = np.meshgrid(np.arange(96) + 0.5, np.arange(72) + 0.5)
        maps = []
        for m in toy.exact:
            i = m.camera.intrinsics
            cam = i.rays(np.column_stack([u.ravel(), v.ravel()])) * m.depth.reshape(-1, 1)
            x = m.camera.cam_from_world.inverse().apply(cam)[:, 0].reshape(72, 96)
            maps.append(replace(m, rgb=np.where((x > 0.17)[..., None], np.uint8(120), m.rgb)))
    builder = replace(toy.with_sizes(iterations=60), uncertainty=ASKED)
    model = builder(component_of(maps), maps)
    assert model.deformation is not None
    y = torch.linspace(-20, 20, 41)
    places = [torch.stack([torch.full_like(y, x), y, torch.zeros_like(y)], dim=1) for x in (-26.0, 26.0)]
    left, right = (model.deformation.along(model.field, p, NADIR).median().item() for p in places)
    assert model.render(down_view(size=40)).confidence.max() > 0.2
    return left, right


def test_a_plain_surface_is_more_uncertain_than_a_textured_one(toy: Toy) -> None:
    left, right = bayes_sigma(toy, plain=True)
    assert right > 2 * left
    left, right = bayes_sigma(toy, plain=False)
    assert 0.5 < right / left < 2
    # A pixel is 1.2 units, and many pixels have been asked.
    assert 0.005 < left < 1.2


def test_the_deformation_is_stretched_like_space(toy: Toy, trained: object) -> None:
    field = trained.field  # type: ignore[attr-defined]
    constant = Deformation(torch.full((3, 2, 4, 4), 0.001))
    inside, outside = (
        constant.along(field, torch.tensor([[x, 0.0, 0.0]]), torch.tensor([1.0, 0.0, 0.0])).item()
        for x in (0.0, 5 * field.box.half)
    )
    assert inside == pytest.approx(0.001 * field.box.inner_per_unit, rel=1e-4)
    assert outside > 10 * inside
    up = constant.along(field, torch.tensor([[5 * field.box.half, 0.0, 0.0]]), NADIR).item()
    assert up == pytest.approx(inside, rel=1e-4)


def numbers(*values: float) -> np.ndarray:
    return np.array(values, np.float32)


def test_every_witness_lowers_the_confidence() -> None:
    best = confidence(numbers(0.9), numbers(1.0), numbers(0.0), numbers(0.0), OPTIONS)[0]
    assert best == pytest.approx(0.9)
    assert confidence(numbers(0.4), numbers(1.0), numbers(0.0), numbers(0.0), OPTIONS)[0] == pytest.approx(0.4)
    assert confidence(numbers(0.9), numbers(0.75), numbers(0.0), numbers(0.0), OPTIONS)[0] == pytest.approx(0.45)
    assert confidence(numbers(0.9), numbers(0.5), numbers(0.0), numbers(0.0), OPTIONS)[0] == 0
    half = confidence(numbers(0.9), numbers(1.0), numbers(OPTIONS.spread_px), numbers(0.0), OPTIONS)[0]
    assert half == pytest.approx(0.45)
    half = confidence(numbers(0.9), numbers(1.0), numbers(0.0), numbers(OPTIONS.bayes_px), OPTIONS)[0]
    assert half == pytest.approx(0.45)
    assert confidence(numbers(0.9), numbers(1.0), numbers(0.0), None, OPTIONS)[0] == pytest.approx(0.9)


def test_confidence_is_never_anything_else_than_a_share() -> None:
    wild = numbers(np.nan, 2.0, -1.0, 0.5)
    found = confidence(wild, numbers(1.0, 1.0, 1.0, np.nan), numbers(0.0, 0.0, np.inf, 0.0), None, OPTIONS)
    assert ((found >= 0) & (found <= 1)).all()
    assert found[0] == found[3] == 0


def test_reliability_counts() -> None:
    sure = numbers(0.1, 0.2, 0.3, 0.9, 0.95, 1.0, 0.5)
    error = numbers(5.0, 0.1, 4.0, 0.1, -0.2, 9.0, np.nan)
    mean, share, counts = reliability(sure, error, 1.0, bins=2)
    assert counts.tolist() == [3, 3]
    assert share.tolist() == pytest.approx([1 / 3, 2 / 3])
    assert mean.tolist() == pytest.approx([0.2, 0.95])
    empty = reliability(numbers(0.9), numbers(0.0), 1.0, bins=2)
    assert np.isnan(empty[1][0])
    assert empty[1][1] == 1
