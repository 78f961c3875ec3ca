# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from skymoor.match.pyramid import Pyramid
from skymoor.types import Raster
from support.pictures import noise_picture


def ramp(shape: tuple[int, int] = (120, 203)) -> Raster:
    """Colours 20 and more, heights that rise by 0.3 pixels per pixel to the right."""
    u = np.tile(np.arange(shape[1]) + 0.5, (shape[0], 1))
    rgb = np.repeat((20 + u)[..., None], 3, axis=-1).astype(np.uint8)
    return Raster(rgb, np.ones(shape, bool), (0.3 * u).astype(np.float32))


@pytest.mark.parametrize("ratio", [1.0, 0.9, 0.7, 0.5, 0.31, 0.25, 0.1, 1.6])
def test_size_and_slope(ratio: float) -> None:
    small = Pyramid(ramp()).at(ratio)
    assert small.rgb.shape == (*small.mask.shape, 3)
    assert small.mask.shape == (round(120 * ratio), round(203 * ratio))
    assert small.height is not None and small.height.shape == small.mask.shape
    slope = np.diff(small.height, axis=1)[:, 2:-2]
    # Heights are in pixels, so a slope is the same at every size.
    assert np.abs(slope - 0.3).max() < 0.06
    middle = (np.arange(small.mask.shape[1]) + 0.5) * 203 / small.mask.shape[1]
    assert np.abs(small.height[0] / ratio - 0.3 * middle)[3:-3].max() < 0.15 / ratio


def test_full_size_is_the_picture_itself() -> None:
    original = ramp()
    assert Pyramid(original).at(1.0) is original


def test_order_of_questions_does_not_matter() -> None:
    rgb = noise_picture((130, 170))
    raster = Raster(rgb, np.ones((130, 170), bool))
    one, two = Pyramid(raster), Pyramid(raster)
    one.at(0.1)
    np.testing.assert_array_equal(one.at(0.3).rgb, two.at(0.3).rgb)
    assert one.at(0.3).height is None


def test_reduction_averages() -> None:
    rgb = np.zeros((64, 64, 3), np.uint8)
    rgb[::2] = 200
    small = Pyramid(Raster(rgb, np.ones((64, 64), bool))).at(0.25)
    assert np.abs(small.rgb.astype(int) - 100).max() <= 1


def test_unknown_stays_unknown() -> None:
    raster = ramp((100, 100))
    assert raster.height is not None
    mask, height = raster.mask.copy(), raster.height.copy()
    mask[:, 60:] = False
    height[:40] = np.nan
    small = Pyramid(Raster(raster.rgb, mask, height)).at(0.4)
    assert small.height is not None
    assert small.mask[:, :23].all() and not small.mask[:, 25:].any()
    assert np.isnan(small.height[:15]).all() and np.isfinite(small.height[17:]).all()
    # Known pixels next to unknown ones keep their own height.
    expected = 0.3 * 0.4 * (np.arange(40) + 0.5) / 0.4
    assert np.abs(small.height[17:] - expected).max() < 0.15
