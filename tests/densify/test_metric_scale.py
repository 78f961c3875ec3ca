# SPDX-License-Identifier: Apache-2.0
"""A known scale comes back, with an error that is neither hidden nor inflated."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.densify import MetricScale, scale_from_metric_depth
from skymoor.errors import TooFewMatches
from skymoor.geometry import Intrinsics, Similarity
from skymoor.types import Array32, Camera, DepthMap

SHAPE = (40, 60)
CAMERA = Camera("a", Intrinsics(60, 40, 50.0, 50.0, 30.0, 20.0), Similarity(1.0, np.eye(3), np.zeros(3)))


def depth_map(rng: np.random.Generator, sigma_ratio: float = 0.01) -> DepthMap:
    depth = rng.uniform(0.5, 3.0, SHAPE).astype(np.float32)
    known = rng.uniform(size=SHAPE) < 0.8
    depth = np.where(known, depth, np.nan).astype(np.float32)
    rgb = np.zeros((*SHAPE, 3), np.uint8)
    return DepthMap(CAMERA, depth, (sigma_ratio * depth).astype(np.float32), known.astype(np.uint8), rgb)


def says(one: DepthMap, scale: float, rng: np.random.Generator, *, photo: float, pixel: float) -> Array32:
    """Depths in metres that are off per photo and per pixel, and quite wrong for a third of the pixels."""
    factor = scale * np.exp(rng.normal(scale=photo) + rng.normal(scale=pixel, size=SHAPE))
    wrong = rng.uniform(size=SHAPE) < 0.3
    return np.where(wrong, rng.uniform(1, 100, SHAPE), one.depth * factor).astype(np.float32)


def test_a_known_scale_comes_back(rng: np.random.Generator) -> None:
    """The stated error is that of a median over photos, checked against what is really made."""
    scale, errors, sigmas = 23.0, [], []
    for _ in range(40):
        maps = [depth_map(rng) for _ in range(9)]
        metres = [says(one, scale, rng, photo=0.2, pixel=0.1) for one in maps]
        found = scale_from_metric_depth(maps, metres, common_sigma_ratio=0.0)
        errors.append(np.log(found.metres_per_unit / scale))
        sigmas.append(found.sigma_ratio)
    assert 0.04 < np.std(errors) < 0.14 and abs(np.mean(errors)) < 0.08
    assert 0.5 < np.std(errors) / np.mean(sigmas) < 1.5


def test_some_photos_may_be_quite_wrong(rng: np.random.Generator) -> None:
    maps = [depth_map(rng) for _ in range(12)]
    factors = [5.0] * 9 + [20.0, 0.1, 80.0]
    found = scale_from_metric_depth(maps, [one.depth * np.float32(f) for one, f in zip(maps, factors, strict=True)])
    assert found.metres_per_unit == pytest.approx(5.0, rel=1e-5)
    np.testing.assert_allclose(found.per_photo, factors, rtol=1e-5)
    assert found.sigma_ratio == pytest.approx(0.15)  # nothing but what the spread cannot show


def test_photos_that_say_nothing_are_left_out(rng: np.random.Generator) -> None:
    maps = [*(depth_map(rng) for _ in range(4)), depth_map(rng, sigma_ratio=0.2), depth_map(rng)]
    metres = [one.depth * np.float32(7) for one in maps[:5]] + [np.full(SHAPE, np.nan, np.float32)]
    assert len(scale_from_metric_depth(maps, metres).per_photo) == 4
    with pytest.raises(TooFewMatches, match="2 of 4 photos have both metric and measured depths"):
        scale_from_metric_depth(maps[2:], metres[2:])


def test_what_is_left_of_a_range() -> None:
    found = MetricScale(2.0, 0.2, np.array([2.0]))
    low, high = found.narrowed(0.6, 2.6)
    assert low == pytest.approx(2.0 * np.exp(-0.5)) and high == 2.6
    assert found.narrowed(0.0, float("inf")) == pytest.approx((2.0 * np.exp(-0.5), 2.0 * np.exp(0.5)))
    assert found.narrowed(5.0, 9.0) == (5.0, 9.0)  # it contradicts all of it
