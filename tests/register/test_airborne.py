# SPDX-License-Identifier: Apache-2.0
"""A planted similarity is found among noise and outliers; nonsense is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comparators import assert_similarity_near
from skymoor.geo.frame import EnuFrame
from skymoor.geo.grid import Grid
from skymoor.geometry.camera import Intrinsics
from skymoor.geometry.similarity import Similarity
from skymoor.register import RegisterOptions, camera_covariances, judge, register
from skymoor.register.airborne import independent_places
from skymoor.types import Calibration, Camera, Matches2D, Matches3D, Reference

TRUTH = Similarity(
    63.0, Rotation.from_euler("zyx", [130.0, 0.4, -0.6], degrees=True).as_matrix(), np.array([25.0, -40.0, 3.0])
)
NOISE_M = np.array([0.15, 0.15, 0.3])


def planted(rng: np.random.Generator, n: int = 1200, outliers: float = 0.4) -> Matches3D:
    level = rng.uniform([-1.2, -1.0, 0.0], [1.2, 1.0, 0.12], (n, 3))
    enu = TRUTH.apply(level) + rng.normal(size=(n, 3)) * NOISE_M
    wrong = rng.random(n) < outliers
    enu[wrong] += rng.uniform(-25, 25, (int(wrong.sum()), 3))
    return Matches3D(level, enu, Matches2D(level[:, :2], enu[:, :2], np.ones(n)))


def test_planted_similarity_is_recovered_and_believed(rng: np.random.Generator) -> None:
    found = judge(register(planted(rng), 0.5, rng=rng), [120.0, 30.0], 3000)
    assert found.registered and found.reason == ""
    assert found.enu_from_level is not None and found.covariance is not None and found.inliers is not None
    assert_similarity_near(found.enu_from_level, TRUTH, rot_deg=0.1, trans_m=0.1, scale_ppm=1500)
    assert 0.55 < found.inlier_ratio < 0.68
    assert 0.25 < found.rmse_m < 0.5
    assert found.tilt_deg == pytest.approx(0.72, abs=0.1)


def test_covariance_counts_places_not_matches(rng: np.random.Generator) -> None:
    """The same matches given four times over are no more certain."""
    once = planted(rng, n=800, outliers=0)
    index = np.tile(np.arange(800), 4)
    often = Matches3D(once.xyz_level[index], once.xyz_enu[index], once.pixels.take(index))
    sigma = [
        np.sqrt(np.trace(found.covariance[4:, 4:]))
        for found in (register(m, 0.5, rng=rng) for m in (once, often))
        if found.covariance is not None
    ]
    assert len(sigma) == 2 and 0.9 < sigma[1] / sigma[0] < 1.1
    errors = []
    for seed in range(20):
        found = register(planted(np.random.default_rng(seed), n=800, outliers=0), 0.5, rng=rng)
        assert found.enu_from_level is not None
        errors.append(np.linalg.norm(found.enu_from_level.apply([[0, 0, 0.05]]) - TRUTH.apply([[0, 0, 0.05]])))
    assert 0.2 * sigma[0] < np.sqrt(np.mean(np.square(errors))) < 1.2 * sigma[0]


def test_scrambled_matches_are_refused(rng: np.random.Generator) -> None:
    given = planted(rng)
    scrambled = replace(given, xyz_enu=rng.permutation(given.xyz_enu))
    found = judge(register(scrambled, 0.5, rng=rng), [120.0, 30.0], 3000)
    assert not found.registered and "agree" in found.reason


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_matches_are_a_refusal_with_a_reason(n: int, rng: np.random.Generator) -> None:
    given = planted(rng, n=20, outliers=0)
    few = Matches3D(given.xyz_level[:n], given.xyz_enu[:n], given.pixels.take(np.arange(n)))
    found = judge(register(few, 0.5, rng=rng), [120.0], n)
    assert not found.registered and found.reason


@pytest.mark.parametrize(
    ("scores", "change", "word"),
    [
        ([32.0, 31.0], {}, "chance"),
        ([60.0, 55.0], {}, "another place"),
        ([120.0, 30.0], {"n_inliers": 20}, "matches agree"),
        ([120.0, 30.0], {"diagnostics": {"cells": 4.0}}, "places only"),
        ([120.0, 30.0], {"tilt_deg": 25.0}, "tilt"),
    ],
)
def test_each_reason_to_refuse(
    scores: list[float], change: dict[str, object], word: str, rng: np.random.Generator
) -> None:
    good = register(planted(rng), 0.5, rng=rng)
    assert judge(good, [120.0, 30.0], 3000).registered
    refused = judge(replace(good, **change), scores, 3000)  # type: ignore[arg-type]
    assert not refused.registered and word in refused.reason


def test_independent_places() -> None:
    points = np.array([[1.0, 1, 0], [2, 2, 5], [11, 1, 0], [-1, 1, 0]])
    assert independent_places(points, 10.0) == 3
    assert independent_places(np.zeros((0, 3)), 10.0) == 0


def test_camera_accuracy_adds_reference_registration_and_focal_length(rng: np.random.Generator) -> None:
    found = register(planted(rng), 0.5, RegisterOptions(), rng=rng)
    grid = Grid(-100, 100, 0.5, (4, 4))
    reference = Reference(
        EnuFrame(50, 8, 100),
        grid,
        np.zeros((4, 4, 3), np.uint8),
        np.ones((4, 4), bool),
        np.zeros((4, 4), np.float32),
        np.diag([1.0, 1.0, 4.0]),
        0.5,
    )
    camera = Camera("a.jpg", Intrinsics(800, 600, 500, 500, 400, 300), Similarity(1.0, np.eye(3), [0, 0, -63.0]))
    sharp = camera_covariances(found, [camera], reference, Calibration(True, 500, 0.0, 1.0, 1.0, False))[0]
    vague = camera_covariances(found, [camera], reference, Calibration(True, 500, 0.0, 0.95, 1.05, True))[0]
    assert 1.0 < sharp[0, 0] < 1.2 and 4.0 < sharp[2, 2] < 4.3
    assert found.centroid_enu is not None
    above = 63.0 - found.centroid_enu[2]
    assert vague[2, 2] - sharp[2, 2] == pytest.approx((0.05 * above) ** 2, rel=1e-6)
