# SPDX-License-Identifier: Apache-2.0
"""A tile is found again in other light; nothing is found in nothing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from skymoor.match.retrieve import UNLIKE, ChannelRetriever
from skymoor.types import Raster


def texture(seed: int, side: int = 160) -> Raster:
    """Streaks of one direction and width per seed."""
    rng = np.random.default_rng(seed)
    size = (int(rng.integers(3, 24)), int(rng.integers(3, 24)))
    noise = cv2.blur(rng.normal(size=(2 * side, 2 * side)).astype(np.float32), size)
    turn = cv2.getRotationMatrix2D((side, side), float(rng.uniform(0, 180)), 1.0)
    part = cv2.warpAffine(noise, turn, (2 * side, 2 * side))[side // 2 : -side // 2, side // 2 : -side // 2]
    grey = np.clip(128 + 45 * part / part.std(), 0, 255).astype(np.uint8)
    return Raster(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.ones(grey.shape, bool))


def in_other_light(raster: Raster, rng: np.random.Generator) -> Raster:
    """Darker, in negative, noisy, and moved by a few pixels."""
    moved = np.roll(raster.rgb, (5, -7), axis=(0, 1)).astype(np.float64)
    rgb = 0.6 * (255 - moved) + 20 + rng.normal(scale=3, size=moved.shape)
    return Raster(np.clip(rgb, 0, 255).astype(np.uint8), raster.mask)


def test_a_tile_is_found_again(rng: np.random.Generator) -> None:
    tiles = [texture(seed) for seed in range(24)]
    likeness = ChannelRetriever()([in_other_light(tile, rng) for tile in tiles], tiles)
    assert likeness.shape == (24, 24)
    ranks = (likeness > np.diag(likeness)[:, None]).sum(axis=1)
    assert np.mean(ranks == 0) > 0.8
    assert ranks.max() <= 4
    assert (np.abs(likeness) <= 1 + 1e-9).all()


def test_one_photo_is_enough(rng: np.random.Generator) -> None:
    tiles = [texture(seed) for seed in range(24)]
    (likeness,) = ChannelRetriever()([in_other_light(tiles[7], rng)], tiles)
    assert (likeness > likeness[7]).sum() <= 2


def test_a_tile_that_shows_nothing_comes_last(rng: np.random.Generator) -> None:
    tiles = [texture(seed) for seed in range(6)]
    tiles[2] = Raster(tiles[2].rgb, np.zeros_like(tiles[2].mask))
    likeness = ChannelRetriever()([in_other_light(tile, rng) for tile in tiles], tiles)
    assert (likeness[:, 2] == UNLIKE).all()
    assert np.isfinite(likeness).all()


@pytest.mark.parametrize(("queries", "tiles"), [(0, 3), (3, 0), (0, 0)])
def test_nothing_to_compare(queries: int, tiles: int) -> None:
    likeness = ChannelRetriever()([texture(k) for k in range(queries)], [texture(k) for k in range(tiles)])
    assert likeness.shape == (queries, tiles)
