# SPDX-License-Identifier: Apache-2.0
"""A known scale and shift of an upright image are recovered, and another image scores like noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from skymoor.ground.walls import FacadeSearchOptions, agreement, drift, search_facades
from skymoor.types import Raster


def windows(seed: int, shape: tuple[int, int] = (60, 120)) -> Raster:
    """A wall with dark windows of some sizes at irregular positions."""
    rng = np.random.default_rng(seed)
    grey = np.full(shape, 170, np.uint8)
    for row in range(6, shape[0] - 12, 18):
        column = 4
        while column < shape[1] - 12:
            width = int(rng.integers(5, 11))
            grey[row : row + int(rng.integers(6, 11)), column : column + width] = rng.integers(20, 80)
            column += width + int(rng.integers(4, 16))
    return Raster(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.ones(shape, dtype=bool))


def part(whole: Raster, scale: float, u0: int, v0: int, size: tuple[int, int]) -> Raster:
    """A part of an image, `size` (width, height) of it, drawn larger by 1 / scale, darker and in reverse contrast."""
    rgb = whole.rgb[v0 : v0 + size[1], u0 : u0 + size[0]]
    rgb = cv2.resize(rgb, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_LINEAR)
    return Raster(200 - rgb // 2, np.ones(rgb.shape[:2], dtype=bool))


@pytest.mark.parametrize("scale", [0.5, 0.58])
def test_scale_and_offset_are_recovered(scale: float) -> None:
    whole = windows(1)
    near = part(whole, scale, 30, 8, (70, 48))
    best = search_facades([near], [windows(2), whole], min_scale=0.4, max_scale=0.75)[0]
    assert best.b == 1
    assert best.scale == pytest.approx(scale, rel=0.03)
    assert best.offset_px == pytest.approx((30, 8), abs=1.5)
    assert best.matrix @ [0, 0, 1] == pytest.approx(best.offset_px)


def test_another_image_scores_lower() -> None:
    whole = windows(1)
    near = part(whole, 0.5, 30, 8, (70, 48))
    right = search_facades([near], [whole], min_scale=0.4, max_scale=0.75)[0].score
    wrong = search_facades([near], [windows(2)], min_scale=0.4, max_scale=0.75)[0].score
    assert 0 < wrong < 0.7 * right


def test_small_and_empty_images_are_skipped() -> None:
    whole = windows(1)
    dark = Raster(whole.rgb, np.zeros_like(whole.mask))
    tiny = part(whole, 1.0, 0, 0, (10, 10))
    assert not search_facades([part(whole, 0.5, 30, 8, (70, 48))], [dark], min_scale=0.4, max_scale=0.6)
    assert not search_facades([tiny], [whole], min_scale=0.9, max_scale=1.1)


def test_agreement_is_one_with_itself_and_falls_with_a_shift() -> None:
    whole = windows(1)
    alike = FacadeSearchOptions(sharp=FacadeSearchOptions().blurred)
    ncc, score = agreement([(whole, whole)], alike)
    assert ncc == pytest.approx(1.0, abs=1e-3)
    assert 0.5 * np.sqrt(whole.mask.size) < score <= np.sqrt(whole.mask.size)
    shifted = Raster(np.roll(whole.rgb, 6, axis=1), whole.mask)
    assert agreement([(shifted, whole)], alike)[0] < 0.5
    assert agreement([]) == (0.0, 0.0)


def test_drift_measures_the_shift() -> None:
    far = windows(0)
    shifted = Raster(np.roll(far.rgb, (6, -9), axis=(0, 1)), far.mask)
    found = drift(shifted, far, reach_px=20, still_px=3)
    assert found is not None
    np.testing.assert_allclose(found.px, (9, -6), atol=0.3)
    assert found.there > 2 * found.here
    unshifted = drift(far, far, reach_px=20, still_px=3)
    assert unshifted is not None
    assert unshifted.here == unshifted.there
    np.testing.assert_allclose(unshifted.px, (0, 0), atol=0.1)
    assert drift(Raster(far.rgb, np.zeros_like(far.mask)), far, reach_px=20, still_px=3) is None
