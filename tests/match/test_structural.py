# SPDX-License-Identifier: Apache-2.0
"""Planted flows must come back to a fraction of a pixel, both ways, without bias."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.match import StructuralMatcher
from skymoor.types import Raster, Warp
from support.pictures import GRID, Overhead, another_day, noise_picture, seen_through, without_heights

Array = NDArray[np.float64]
SHAPE = (150, 180)
MARGIN = 20  # windows and displacements reach over the border there


def centres(shape: tuple[int, int]) -> Array:
    u, v = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    return np.stack([u, v], axis=-1)


def swell(px: Array) -> Array:
    """A smooth displacement of up to 5 pixels on top of a shift by fractions."""
    u, v = px[..., 0], px[..., 1]
    return np.stack([1.3 + 2.5 * np.sin(v / 40) + 0.01 * u, -0.7 + 2.0 * np.cos(u / 50)], axis=-1)


def moved(px: Array) -> Array:
    """Pixel of the first picture that the warped picture shows at a pixel."""
    return px + swell(px)


def inverse(px: Array) -> Array:
    guess = px.copy()
    for _ in range(30):
        guess = px - swell(guess)
    return guess


def inner(values: Array) -> Array:
    return values[MARGIN:-MARGIN, MARGIN:-MARGIN]


@pytest.fixture(scope="module")
def first(first_day: Overhead) -> Raster:
    return seen_through(first_day, lambda px: px + [40, 30], SHAPE)


@pytest.fixture(scope="module")
def second(first_day: Overhead) -> Raster:
    """Seen through the swell, with other radiometry and noise."""
    return another_day(seen_through(first_day, lambda px: moved(px) + [40, 30], SHAPE))


def test_a_picture_on_itself_has_no_flow(first: Raster) -> None:
    warp = StructuralMatcher()(first, first)
    for flow, confidence in ((warp.b_from_a, warp.confidence_a), (warp.a_from_b, warp.confidence_b)):
        assert flow.shape == (*SHAPE, 2) and confidence.shape == SHAPE
        error = inner(flow - centres(SHAPE))
        assert np.abs(error.mean(axis=(0, 1))).max() < 0.02
        assert np.abs(error).max() < 0.1
        assert inner(confidence).mean() > 0.9


@pytest.mark.parametrize("shift", [(3, 0), (-2, 5), (0, -7)])
def test_whole_shifts_are_exact(shift: tuple[int, int]) -> None:
    rgb = noise_picture((170, 200))
    a = Raster(rgb[10:160, 10:190], np.ones(SHAPE, bool))
    b = Raster(rgb[10 + shift[1] : 160 + shift[1], 10 + shift[0] : 190 + shift[0]], np.ones(SHAPE, bool))
    warp = StructuralMatcher()(a, b)
    # b begins `shift` later, so what is at p in a is at p - shift in b.
    for flow, sign in ((warp.b_from_a, -1), (warp.a_from_b, 1)):
        error = inner(flow - centres(SHAPE)) - sign * np.array(shift)
        assert np.abs(np.median(error, axis=(0, 1))).max() < 0.02
        assert np.percentile(np.abs(error), 99) < 0.15


@pytest.mark.parametrize("heights", [True, False])
def test_a_smooth_warp_comes_back_both_ways(first: Raster, second: Raster, heights: bool) -> None:
    a, b = (first, second) if heights else (without_heights(first), without_heights(second))
    warp = StructuralMatcher()(a, b)
    for flow, confidence, truth in (
        (warp.a_from_b, warp.confidence_b, moved(centres(SHAPE))),
        (warp.b_from_a, warp.confidence_a, inverse(centres(SHAPE))),
    ):
        sure = inner(confidence) > 0.3
        assert sure.mean() > 0.75
        error = inner(flow - truth)[sure]
        # A window of 7 pixels flattens this swell by up to 0.04 pixels, to one side.
        assert np.abs(np.median(error, axis=0)).max() < 0.08
        length = np.linalg.norm(error, axis=1)
        assert 0.01 < np.median(length) < 0.25
        assert np.percentile(length, 95) < 0.9


def test_another_season_sun_and_cars_leave_a_quarter_of_a_pixel(first: Raster, other_day: Overhead) -> None:
    other = another_day(seen_through(other_day, lambda px: moved(px) + [40, 30], SHAPE))
    warp = StructuralMatcher()(first, other)
    sure = inner(warp.confidence_b) > 0.3
    assert sure.mean() > 0.7
    error = inner(warp.a_from_b - moved(centres(SHAPE)))
    # Shadows are longer, and lie elsewhere: they draw all matches a little to one side.
    assert np.abs(np.median(error[sure], axis=0)).max() < 0.25
    length, confidence = np.linalg.norm(error, axis=-1), inner(warp.confidence_b)
    assert np.median(length[sure]) < 0.4
    doubtful, certain = (length[confidence < np.quantile(confidence, 0.15)], length[confidence > np.median(confidence)])
    assert doubtful.mean() > 1.3 * certain.mean()


def test_another_place_is_not_confident(first: Raster, next_door: Overhead) -> None:
    other = another_day(seen_through(next_door, lambda px: px + [40, 30], SHAPE))
    warp = StructuralMatcher()(first, other)
    assert inner(warp.confidence_a).mean() < 0.25
    assert (inner(warp.confidence_a) > 0.5).mean() < 0.05


def test_unknown_and_flat_parts_are_not_confident(first: Raster) -> None:
    rgb, mask = first.rgb.copy(), first.mask.copy()
    mask[:, 120:] = False
    rgb[90:, :60] = 128
    warp = StructuralMatcher()(Raster(rgb, mask), Raster(rgb, mask))
    assert not warp.confidence_a[:, 120:].any() and not warp.confidence_b[:, 120:].any()
    assert np.median(warp.confidence_a[115:140, 15:40]) < 0.2
    assert np.median(warp.confidence_a[20:70, 20:90]) > 0.8


def test_displacements_out_of_reach_are_not_believed() -> None:
    rgb = noise_picture((170, 220))
    a, b = (Raster(rgb[10:160, start : start + 180], np.ones(SHAPE, bool)) for start in (10, 30))
    warp = StructuralMatcher(reach_px=8)(a, b)
    assert (inner(warp.confidence_a) > 0.5).mean() < 0.05


def test_pictures_of_two_sizes_are_a_mistake(first: Raster) -> None:
    smaller = Raster(first.rgb[:-1], first.mask[:-1])
    with pytest.raises(ValueError, match="equal size"):
        StructuralMatcher()(first, smaller)


def test_grid_spacing_changes_little(first: Raster, second: Raster) -> None:
    coarse, fine = (StructuralMatcher(grid_px=g)(first, second) for g in (6, 1))
    assert isinstance(coarse, Warp) and GRID.pixel_m == 0.8
    sure = inner(np.minimum(coarse.confidence_a, fine.confidence_a)) > 0.3
    difference = np.linalg.norm(inner(coarse.b_from_a - fine.b_from_a), axis=-1)[sure]
    assert np.median(difference) < 0.1
