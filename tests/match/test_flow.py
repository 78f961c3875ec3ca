# SPDX-License-Identifier: Apache-2.0
"""From the grids and points of learned engines to pixels: no half pixel, no aspect, no order may get lost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.match import CyclicOptions, cyclic_matches
from skymoor.match.flow import EngineFlow, warp_from_flows, warp_from_pairs
from skymoor.types import Matches2D, Raster, Warp

Array = NDArray[np.float64]
SHAPE_A, SHAPE_B = (120, 200), (150, 90)
MATRIX = np.array([[0.42, 0.03, 1.7], [-0.02, 1.18, 3.4]])  # px of b from px of a
BACK = np.vstack([MATRIX, [0, 0, 1]])
BACK = np.linalg.inv(BACK)[:2]
ALL = CyclicOptions(max_matches=10**6)


def raster(shape: tuple[int, int]) -> Raster:
    return Raster(np.zeros((*shape, 3), np.uint8), np.ones(shape, bool))


def affine(matrix: Array) -> Callable[[Array], Array]:
    return lambda px: px @ matrix[:, :2].T + matrix[:, 2]


def centres(shape: tuple[int, int]) -> Array:
    return np.stack(np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5), axis=-1)


def engine_flow(
    move: Callable[[Array], Array],
    source: tuple[int, int],
    target: tuple[int, int],
    grid: tuple[int, int] = (48, 64),
    certainty: float = 0.9,
) -> EngineFlow:
    """What a perfect engine says on its grid, by the definition of align_corners=False."""
    size = np.array([source[1], source[0]])
    normalised = (2 * centres(grid) / [grid[1], grid[0]]) - 1
    there = move((normalised + 1) / 2 * size) / [target[1], target[0]] * 2 - 1
    return EngineFlow(there.astype(np.float32), np.full(grid, certainty, np.float32))


def both_ways(grid: tuple[int, int] = (48, 64)) -> Warp:
    return warp_from_flows(
        raster(SHAPE_A),
        raster(SHAPE_B),
        engine_flow(affine(MATRIX), SHAPE_A, SHAPE_B, grid),
        engine_flow(affine(BACK), SHAPE_B, SHAPE_A, grid),
    )


class TestFlows:
    @pytest.mark.parametrize("grid", [(48, 64), (64, 64), (37, 23), (300, 400)])
    def test_affine_of_pictures_of_two_shapes(self, grid: tuple[int, int]) -> None:
        warp = both_ways(grid)
        for flow, matrix, shape in (
            (warp.b_from_a, MATRIX, SHAPE_A),
            (warp.a_from_b, BACK, SHAPE_B),
        ):
            error = np.linalg.norm(flow - affine(matrix)(centres(shape)), axis=-1)
            # Half a cell inside the border, where nothing is held.
            v, u = (int(np.ceil(side / cells / 2)) for side, cells in zip(shape, grid, strict=True))
            assert error[v : shape[0] - v, u : shape[1] - u].max() < 2e-3
            assert error.max() < 2.0 * max(shape[0] / grid[0], shape[1] / grid[1])

    def test_error_put_in_comes_out(self) -> None:
        """Half a pixel of b, which any confusion of conventions would cost, is seen."""
        shifted = MATRIX + [[0, 0, 0.5], [0, 0, 0]]
        there = engine_flow(affine(shifted), SHAPE_A, SHAPE_B)
        warp = warp_from_flows(raster(SHAPE_A), raster(SHAPE_B), there, engine_flow(affine(BACK), SHAPE_B, SHAPE_A))
        error = (warp.b_from_a - affine(MATRIX)(centres(SHAPE_A)))[4:-4, 4:-4]
        np.testing.assert_allclose(error.reshape(-1, 2), np.tile([0.5, 0.0], (error[..., 0].size, 1)), atol=2e-3)

    def test_bent_flow(self) -> None:
        def bent(px: Array) -> Array:
            return affine(MATRIX)(px) + 3 * np.sin(px[..., ::-1] / 25)

        there = engine_flow(bent, SHAPE_A, SHAPE_B, (96, 128))
        warp = warp_from_flows(raster(SHAPE_A), raster(SHAPE_B), there, engine_flow(affine(BACK), SHAPE_B, SHAPE_A))
        error = np.linalg.norm(warp.b_from_a - bent(centres(SHAPE_A)), axis=-1)[2:-2, 2:-2]
        assert 1e-4 < error.max() < 0.01

    def test_matches_that_return(self) -> None:
        found = cyclic_matches(both_ways(), ALL, rng=np.random.default_rng(0))
        there = affine(MATRIX)(centres(SHAPE_A))
        inside = (there > 0.5).all(axis=-1) & (there < np.array([SHAPE_B[1], SHAPE_B[0]]) - 0.5).all(axis=-1)
        assert 0.98 * inside.sum() < len(found) <= inside.sum()
        assert np.abs(found.px_b - affine(MATRIX)(found.px_a)).max() < 0.5
        assert found.confidence.max() < 0.9 + 1e-6 and np.mean(found.confidence > 0.9 - 1e-6) > 0.9

    def test_confidence_is_zero_where_nothing_can_be_meant(self) -> None:
        a, b = raster(SHAPE_A), raster(SHAPE_B)
        a.mask[:, :30] = False
        b.mask[60:80] = False
        warp = warp_from_flows(
            a, b, engine_flow(affine(MATRIX), SHAPE_A, SHAPE_B), engine_flow(affine(BACK), SHAPE_B, SHAPE_A)
        )
        there = affine(MATRIX)(centres(SHAPE_A))
        v = there[..., 1]
        assert not warp.confidence_a[:, :30].any()
        assert not warp.confidence_a[(v > 60.01) & (v < 79.99)].any()
        assert not warp.confidence_a[(v > SHAPE_B[0]) | (v < 0)].any()
        assert not warp.confidence_b[60:80].any()
        assert not warp.confidence_b[affine(BACK)(centres(SHAPE_B))[..., 0] < 29.99].any()
        u = there[..., 0]
        clear = (v > 1) & (v < 59) & (u > 1) & (u < SHAPE_B[1] - 1)
        clear[:, :32] = False
        np.testing.assert_allclose(warp.confidence_a[clear], 0.9, atol=1e-6)

    def test_what_an_engine_clamps_to_the_edge_is_outside(self) -> None:
        flow = engine_flow(affine(MATRIX), SHAPE_A, SHAPE_B)
        flow.target[:24] = np.clip(flow.target[:24] - 3, -1, 1)
        flow.target[24:] = np.clip(flow.target[24:] + 3, -1, 1)
        warp = warp_from_flows(raster(SHAPE_A), raster(SHAPE_B), flow, engine_flow(affine(BACK), SHAPE_B, SHAPE_A))
        sure = np.delete(warp.confidence_a, slice(57, 63), axis=0)  # between the halves the flow crosses the picture
        assert not sure.any()


class TestPairs:
    def matched(self, px_a: Array, px_b: Array, confidence: Array) -> Matches2D:
        warp = warp_from_pairs(raster(SHAPE_A), raster(SHAPE_B), px_a, px_b, confidence)
        return cyclic_matches(warp, ALL, rng=np.random.default_rng(0))

    def test_points_come_out_as_they_went_in(self) -> None:
        rng = np.random.default_rng(0)
        cells = rng.choice(15 * 9, 60, replace=False)  # one in each cell of 8 x 8 at most
        px_a = np.column_stack([cells % 9, cells // 9]) * 8.0 + 4 + rng.uniform(-2, 2, (60, 2))
        px_b = px_a + [5.3, 9.8] + rng.normal(scale=0.3, size=(60, 2))
        sure = rng.uniform(0.3, 1.0, 60)
        found = self.matched(px_a, px_b, sure)
        assert len(found) == 60
        order = np.lexsort((np.floor(px_a[:, 0]), np.floor(px_a[:, 1])))
        np.testing.assert_array_equal(found.px_a, np.floor(px_a[order]) + 0.5)
        np.testing.assert_allclose(found.px_b - found.px_a, (px_b - px_a)[order], atol=1e-4)
        np.testing.assert_allclose(found.confidence, sure[order], atol=1e-6)

    def test_nothing_is_said_elsewhere(self) -> None:
        warp = warp_from_pairs(raster(SHAPE_A), raster(SHAPE_B), [[10.2, 20.9]], [[14.0, 22.0]], [0.8])
        assert np.count_nonzero(warp.confidence_a) == 1 and np.count_nonzero(warp.confidence_b) == 4
        assert np.isfinite(warp.b_from_a).all() and np.isfinite(warp.a_from_b).all()

    def test_the_surest_of_a_pixel_counts(self) -> None:
        px_a = np.array([[10.2, 20.9], [10.7, 20.1], [10.5, 20.5]])
        px_b = np.array([[30.0, 40.0], [50.0, 60.0], [70.0, 80.0]])
        found = self.matched(px_a, px_b, np.array([0.5, 0.9, 0.3]))
        np.testing.assert_allclose(found.px_b, [[49.8, 60.4]], atol=1e-4)

    def test_what_lies_off_the_pictures_is_left_out(self) -> None:
        px_a = np.array([[10.0, 10.0], [-3.0, 5.0], [50.0, 50.0], [60.0, 60.0], [np.nan, 4.0]])
        px_b = np.array([[12.0, 10.0], [5.0, 5.0], [95.0, 50.0], [60.0, -0.1], [4.0, 4.0]])
        found = self.matched(px_a, px_b, np.ones(5))
        np.testing.assert_allclose(found.px_b - found.px_a, [[2.0, 0.0]], atol=1e-5)

    def test_no_points(self) -> None:
        assert len(self.matched(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))) == 0
