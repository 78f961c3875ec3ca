# SPDX-License-Identifier: Apache-2.0
"""Pixels of both pictures through resampling, matching and back: centres must stay centres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.match import CyclicOptions, ImageHypothesis, StructuralMatcher, match_hypothesis, warp_raster
from skymoor.types import Raster, Warp
from support.pictures import GRID, Overhead, another_day, noise_picture, seen_through

Array = NDArray[np.float64]
IDENTITY = np.eye(2, 3)


def ramp(shape: tuple[int, int]) -> Raster:
    """Heights and colours that say where they are: u in the first colour, v in the second; heights u + 2 v."""
    u, v = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    rgb = np.stack([u, v, 0 * u], axis=-1)
    return Raster(rgb.astype(np.uint8), np.ones(shape, bool), (u + 2 * v).astype(np.float32))


def placed_points(matrix: Array, px: Array) -> Array:
    return np.asarray(px @ matrix[:, :2].T + matrix[:, 2])


class TestLay:
    def test_identity_is_the_picture(self) -> None:
        a = Raster(noise_picture((50, 70)), np.ones((50, 70), bool), ramp((50, 70)).height)
        warped = warp_raster(a, IDENTITY, (70, 50))
        np.testing.assert_array_equal(warped.rgb, a.rgb)
        np.testing.assert_array_equal(warped.mask, a.mask)
        np.testing.assert_allclose(warped.height, a.height, rtol=1e-6)

    def test_whole_shift(self) -> None:
        a = ramp((50, 70))
        warped = warp_raster(a, np.column_stack([np.eye(2), [5, -3]]), (70, 50))
        np.testing.assert_array_equal(warped.rgb[:47, 5:], a.rgb[3:, :65])
        assert warped.mask[:47, 5:].all() and not warped.mask[:, :5].any() and not warped.mask[47:].any()
        assert warped.height is not None and np.isnan(warped.height[47:]).all()

    @pytest.mark.parametrize("scale", [0.2, 0.37, 0.5, 0.8, 1.0, 1.7])
    @pytest.mark.parametrize("heading_deg", [0, 90, 33])
    def test_every_pixel_shows_what_it_should(self, scale: float, heading_deg: float) -> None:
        shape = (150, 190)
        a = ramp(shape)
        matrix = ImageHypothesis(scale, np.radians(heading_deg), (120.3, 99.6), 0.0).matrix(shape)
        warped = warp_raster(a, matrix, (240, 200))
        rows, columns = np.nonzero(warped.mask)
        assert len(rows) > 0.8 * min(scale**2 * 150 * 190, 20000)
        linear = np.linalg.inv(matrix[:, :2])
        px_a = (np.column_stack([columns, rows]) + 0.5 - matrix[:, 2]) @ linear.T
        assert warped.height is not None
        # Heights are linear, so averaging changes nothing; they come in pixels of the warped picture.
        error = warped.height[rows, columns] / scale - px_a @ [1, 2]
        assert np.abs(np.median(error)) < 0.02
        # OpenCV rounds places to 1/32 of a pixel, and heights climb by 3 across one.
        assert np.percentile(np.abs(error), 98) * scale < 0.2
        colours = warped.rgb[rows, columns, :2].astype(float) + 0.5
        assert np.abs(np.median(colours - px_a, axis=0)).max() < 1.0  # rounded twice

    def test_holes_stay_holes(self) -> None:
        a = ramp((60, 60))
        mask, height = a.mask.copy(), np.array(a.height)
        mask[20:30] = False
        height[40:50] = np.nan
        warped = warp_raster(Raster(a.rgb, mask, height), np.column_stack([np.eye(2) * 2, [0, 0]]), (120, 120))
        assert warped.height is not None
        assert not warped.mask[40:60].any() and warped.mask[65:115, 5:-5].all()
        assert np.isnan(warped.height[80:100]).all() and np.isfinite(warped.height[5:75, 5:-5]).all()


@pytest.mark.parametrize("heading_deg", [0.0, 70.0, 205.0])
@pytest.mark.parametrize("scale", [0.45, 1.2])
def test_matches_of_a_placed_picture_are_exact(first_day: Overhead, heading_deg: float, scale: float) -> None:
    shape = (round(75 / scale), round(95 / scale))
    truth = ImageHypothesis(scale, np.radians(heading_deg), (118.4, 97.7), 0.0).matrix(shape)
    a = seen_through(first_day, lambda px: placed_points(truth, px), shape)
    assert a.height is not None
    a = Raster(a.rgb, a.mask, (a.height / np.float32(scale)).astype(np.float32))
    b = another_day(seen_through(first_day, lambda px: px, GRID.shape))
    # The search is right to a degree, a percent and a pixel; what is left must not show in the matches.
    approximate = ImageHypothesis(1.01 * scale, np.radians(heading_deg + 0.8), (119.3, 97.1), 0.0).matrix(shape)
    matches, warp = match_hypothesis(a, b, approximate, StructuralMatcher(), rng=np.random.default_rng(0))
    assert len(matches) > 1000
    assert (matches.px_a >= 0).all() and (matches.px_a <= [shape[1], shape[0]]).all()
    error = matches.px_b - placed_points(truth, matches.px_a)
    assert np.abs(error.mean(axis=0)).max() < 0.04
    assert 0.005 < np.median(np.linalg.norm(error, axis=1)) < 0.2
    assert np.percentile(np.linalg.norm(error, axis=1), 95) < 0.7
    assert warp.confidence_a.shape[0] < GRID.shape[0]  # only the covered part is matched


class TestFrames:
    """With a matcher that answers exactly, no resampling or cropping may move a match."""

    @pytest.mark.parametrize("place", [(60.0, 50.0), (20.0, 15.0), (100.0, 90.0)], ids=["inside", "corner", "other"])
    @pytest.mark.parametrize("scale", [0.3, 0.5, 1.0, 1.9])
    def test_oracle(self, place: tuple[float, float], scale: float) -> None:
        shape = (round(60 / scale), round(80 / scale))
        a, b = ramp(shape), ramp((100, 120))
        approximate = ImageHypothesis(scale, 0.3, place, 0.0).matrix(shape)

        def identity(x: Raster, y: Raster) -> Warp:
            assert x.mask.shape == y.mask.shape
            u, v = np.meshgrid(np.arange(x.mask.shape[1]) + 0.5, np.arange(x.mask.shape[0]) + 0.5)
            same, sure = np.stack([u, v], axis=-1).astype(np.float32), x.mask.astype(np.float32)
            return Warp(same, sure, same.copy(), y.mask.astype(np.float32))

        options = CyclicOptions(max_matches=300)
        matches, _ = match_hypothesis(a, b, approximate, identity, options, rng=np.random.default_rng(0))
        assert len(matches) == 300
        np.testing.assert_allclose(matches.px_b, placed_points(approximate, matches.px_a), atol=1e-3)
        assert (matches.px_b >= 0).all() and (matches.px_b <= [120, 100]).all()
        # The pictures given to the matcher showed the right parts: b knows where it is by its colours.
        u, v = np.floor(matches.px_b).astype(int).T
        np.testing.assert_array_equal(b.rgb[v, u, 0], u)

    def test_the_matcher_sees_corresponding_parts(self) -> None:
        shape = (120, 160)
        a, b = ramp(shape), ramp((100, 120))
        approximate = ImageHypothesis(0.5, 0.0, (60.0, 50.0), 0.0).matrix(shape)
        seen: list[tuple[Raster, Raster]] = []
        match_hypothesis(a, b, approximate, _recorder(seen), rng=np.random.default_rng(0), margin_px=4)
        ((warped, part),) = seen
        assert part.mask.shape == (60 + 8, 80 + 8)
        # Corner of a at (20, 20) of b; the part begins 4 pixels before.
        assert tuple(part.rgb[0, 0, :2]) == (16, 16)
        assert warped.mask[4:64, 4:84].all() and not warped.mask[:4].any()
        assert np.abs(warped.rgb[6:60, 6:80, 0].astype(float).mean(axis=0) - (2 * np.arange(2, 76) + 0.5)).max() < 1.0


def _recorder(seen: list[tuple[Raster, Raster]]) -> Callable[[Raster, Raster], Warp]:
    def match(a: Raster, b: Raster) -> Warp:
        seen.append((a, b))
        nothing = np.zeros(a.mask.shape, np.float32)
        return Warp(
            np.zeros((*a.mask.shape, 2), np.float32), nothing, np.zeros((*b.mask.shape, 2), np.float32), nothing
        )

    return match
