# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from skymoor.densify.fuse import fuse_depths

SHAPE = (60, 80)
TRUE = 50.0


def layers(*values: float) -> np.ndarray:
    return np.stack([np.full(SHAPE, value, np.float32) for value in values])


def test_an_outlier_is_left_out() -> None:
    depth, sigma, views = fuse_depths(layers(50.0, 50.02, 57.0, 49.98), layers(0.1, 0.1, 0.01, 0.1), min_views=2)
    assert np.abs(depth - 50).max() < 0.02
    assert (views == 3).all()
    assert (sigma > 0.05).all()


def test_what_no_two_agree_on_is_unknown() -> None:
    depth, sigma, views = fuse_depths(layers(50, 52, 54), layers(0.1, 0.1, 0.1), min_views=2)
    assert np.isnan(depth).all() and np.isnan(sigma).all() and (views == 0).all()


def test_nan_partners_do_not_count() -> None:
    nan = float("nan")
    depth, _, views = fuse_depths(layers(nan, 50, 50.01, nan), layers(nan, 0.1, 0.1, nan), min_views=2)
    assert np.abs(depth - 50).max() < 0.02 and (views == 2).all()
    alone, _, _ = fuse_depths(layers(nan, 50, nan), layers(nan, 0.1, nan), min_views=2)
    assert np.isnan(alone).all()


def test_certain_partners_weigh_more() -> None:
    depth, _, _ = fuse_depths(layers(50.0, 50.3), layers(0.05, 0.5), min_views=2)
    expected = (50 / 0.05**2 + 50.3 / 0.5**2) / (1 / 0.05**2 + 1 / 0.5**2)
    assert np.abs(depth - expected).max() < 1e-3


@pytest.mark.parametrize("common", [0.0, 0.7])
def test_sigma_is_right_when_partners_share_a_part_of_their_error(common: float) -> None:
    rng = np.random.default_rng(1)
    sigma_in = 0.1
    own = rng.normal(size=(4, *SHAPE)) * np.sqrt(1 - common)
    shared = rng.normal(size=SHAPE) * np.sqrt(common)
    depths = (TRUE + sigma_in * (own + shared)).astype(np.float32)
    depth, sigma, _ = fuse_depths(depths, np.full_like(depths, sigma_in), min_views=2)
    normalised = (depth - TRUE) / sigma
    assert abs(float(np.mean(normalised))) < 0.05
    assert 0.4 < float(np.sqrt(np.mean(normalised**2))) < 1.5
    assert 0.07 < float(np.median(sigma)) < 0.1


def test_sigma_is_not_below_the_spread() -> None:
    depth, sigma, _ = fuse_depths(layers(49.95, 50.05), layers(0.01, 0.01), min_views=2)
    assert np.abs(depth - 50).max() < 1e-3
    assert (sigma > 0.045).all()
