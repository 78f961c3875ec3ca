# SPDX-License-Identifier: Apache-2.0
"""Exposures of photos that were put in are found again."""

from __future__ import annotations

import numpy as np

from skymoor.model.nerf.exposure import exposure_log_gains


def looks(rng: np.random.Generator, gains: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each of 400 places, seen by four photos of those that `gains` (n, 3) are of."""
    place = np.repeat(np.arange(400), 4)
    image = np.concatenate([rng.choice(len(gains), 4, replace=False) for _ in range(400)])
    colours = rng.uniform(-2.0, -0.2, (400, 3))
    return image, place, colours[place] + gains[image] + noise * rng.standard_normal((1600, 3))


def test_known_gains_are_found(rng: np.random.Generator) -> None:
    gains = 0.15 * rng.standard_normal((9, 3))
    found = exposure_log_gains(*looks(rng, gains, noise=0.03), 9)
    error = found - (gains - gains.mean(axis=0))
    assert 1e-5 < np.sqrt((error**2).mean()) < 0.006
    np.testing.assert_allclose(found.mean(axis=0), 0, atol=1e-9)


def test_what_moves_is_no_exposure(rng: np.random.Generator) -> None:
    gains = 0.15 * rng.standard_normal((9, 3))
    image, place, log_rgb = looks(rng, gains, noise=0.03)
    wrong = rng.uniform(size=len(image)) < 0.1
    log_rgb[wrong & (image < 3)] += 1.0
    error = exposure_log_gains(image, place, log_rgb, 9) - (gains - gains.mean(axis=0))
    assert np.abs(error).max() < 0.06


def test_photos_that_share_nothing_keep_their_exposure(rng: np.random.Generator) -> None:
    gains = 0.2 * rng.standard_normal((5, 3))
    image, place, log_rgb = looks(rng, gains, noise=0.0)
    found = exposure_log_gains(image, place, log_rgb, 7)
    assert found.shape == (7, 3)
    assert np.abs(found).max() < 1.0
    difference = (found[:5] - found[:5].mean(axis=0)) - (gains - gains.mean(axis=0))
    assert np.abs(difference).max() < 0.03
    assert not exposure_log_gains(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), 4).any()
