# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Plane, fit_plane_ransac

Array = NDArray[np.float64]
NORMAL = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
SIGMA = 0.1


def on_plane(rng: np.random.Generator, n: int, normal: Array = NORMAL, offset: float = 12.0) -> Array:
    across = np.linalg.svd(normal[None])[2][1:]
    return rng.uniform(-50, 50, (n, 2)) @ across + normal * (offset + rng.normal(size=(n, 1)) * SIGMA)


def angle_deg(a: Array, b: Array) -> float:
    return float(np.degrees(np.arcsin(np.linalg.norm(np.cross(a, b)))))


def test_recovers_the_plane_under_outliers() -> None:
    angles, offsets = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        points = np.vstack([on_plane(rng, 400), rng.uniform(-50, 50, (600, 3))])
        plane, inliers = fit_plane_ransac(points, threshold=0.35, rng=rng)
        angles.append(angle_deg(plane.normal, NORMAL))
        offsets.append(plane.offset - 12.0)
        assert inliers[:400].mean() > 0.98
        assert inliers[400:].mean() < 0.03
        assert plane.normal[2] > 0
    # Two angles, each good to sigma over the root of the summed squared arms.
    expected_deg = np.degrees(SIGMA * np.sqrt(2) / (100 / np.sqrt(12) * np.sqrt(400)))
    assert 0.4 * expected_deg < np.sqrt(np.mean(np.square(angles))) < 2.0 * expected_deg
    assert 0.4 * SIGMA / 20 < np.sqrt(np.mean(np.square(offsets))) < 2.0 * SIGMA / 20


def test_far_from_the_origin() -> None:
    rng = np.random.default_rng(1)
    shift = np.array([512_345.0, 5_212_345.0, 432.0])
    plane, inliers = fit_plane_ransac(on_plane(rng, 200) + shift, threshold=0.5, rng=rng)
    assert inliers.all()
    np.testing.assert_allclose(plane.height(on_plane(rng, 200) + shift), 0.0, atol=0.5)


def test_tilt_limit_passes_over_the_larger_wall() -> None:
    rng = np.random.default_rng(2)
    points = np.vstack([on_plane(rng, 200), on_plane(rng, 600, np.array([1.0, 0.0, 0.0]))])
    wall, _ = fit_plane_ransac(points, threshold=0.35, rng=rng)
    assert angle_deg(wall.normal, np.array([1.0, 0.0, 0.0])) < 0.2
    ground, inliers = fit_plane_ransac(points, threshold=0.35, rng=rng, max_tilt_from=(np.array([0, 0, -3.0]), 20.0))
    assert angle_deg(ground.normal, NORMAL) < 0.2
    assert ground.normal[2] < 0  # to the side of the given direction
    assert ground.offset == pytest.approx(-12.0, abs=0.05)
    assert inliers[:200].mean() > 0.98


def test_weights_choose_the_plane() -> None:
    rng = np.random.default_rng(3)
    points = np.vstack([on_plane(rng, 100), on_plane(rng, 300, offset=20.0)])
    weights = np.repeat([10.0, 1.0], [100, 300])
    assert fit_plane_ransac(points, threshold=0.35, rng=rng)[0].offset == pytest.approx(20.0, abs=0.1)
    assert fit_plane_ransac(points, threshold=0.35, rng=rng, weights=weights)[0].offset == pytest.approx(12.0, abs=0.1)


def test_same_generator_same_plane() -> None:
    points = np.random.default_rng(4).normal(size=(500, 3))
    a, b = (fit_plane_ransac(points, threshold=0.1, rng=np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a[0].normal, b[0].normal)
    np.testing.assert_array_equal(a[1], b[1])


def test_degenerate() -> None:
    rng = np.random.default_rng(6)
    with pytest.raises(TooFewMatches):
        fit_plane_ransac(np.zeros((2, 3)), threshold=0.1, rng=rng)
    with pytest.raises(TooFewMatches):
        fit_plane_ransac(on_plane(rng, 5), threshold=0.1, rng=rng, weights=[1, 1, 0, 0, 0])
    line = np.linspace(-50, 50, 40)[:, None] * [0.3, 0.7, 0.1] + [512_345, 5_212_345, 432]
    for points in (line, np.ones((10, 3))):
        with pytest.raises(DegenerateGeometry, match="one line"):
            fit_plane_ransac(points, threshold=0.1, rng=rng)
    flat = on_plane(rng, 50) * [1, 1, 0]
    with pytest.raises(DegenerateGeometry, match="tilt"):
        fit_plane_ransac(flat, threshold=0.5, rng=rng, max_tilt_from=([1.0, 0, 0], 20.0))
    with pytest.raises(DegenerateGeometry, match="length 1"):
        Plane(np.array([0.0, 0.0, 2.0]), 1.0)
