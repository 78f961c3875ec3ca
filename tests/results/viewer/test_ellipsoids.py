# SPDX-License-Identifier: Apache-2.0
"""Ellipsoids hold nine of ten errors, and those of former versions agree with the ellipse and LE90."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.results.read import STATISTICS, Result
from skymoor.results.viewer.ellipsoids import camera_ellipsoids, ellipsoids
from support.finished import finished_run


def test_an_ellipsoid_holds_nine_of_ten_errors() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3)) * [[0.2], [1.0], [3.0]]
    found = ellipsoids(np.zeros((1, 3)), (root @ root.T)[None])
    errors = rng.multivariate_normal(np.zeros(3), root @ root.T, 40_000)
    own = Rotation.from_quat(found.wxyz[0], scalar_first=True).inv().apply(errors) / found.semi_axes[0]
    assert np.mean(np.linalg.norm(own, axis=1) <= 1) == pytest.approx(0.9, abs=0.006)
    assert np.linalg.norm(found.wxyz[0]) == pytest.approx(1)


@pytest.mark.parametrize("former", [False, True])
def test_those_of_a_run(tmp_path: Path, former: bool) -> None:
    """The run's relative covariance is diag(0.01, 0.02, 0.05); its cameras.csv has an LE90 of 0.9 m."""
    run = finished_run(tmp_path)
    if former:
        statistics = json.loads((run / STATISTICS).read_text())
        for row in statistics["airborne_0"]["photos"]:
            del row["covariance_m2"], row["relative_covariance_m2"]
        (run / STATISTICS).write_text(json.dumps(statistics))
    found = camera_ellipsoids(Result.read(run), "relative to the reference")
    assert len(found.semi_axes) == 9
    upright = 0.9 / 1.645 if former else np.sqrt(0.05)
    known = [one for one in found.semi_axes if np.allclose(sorted(one)[0], 2.5 * 0.1, rtol=0.01)]
    assert len(known) == 8  # the statistics name the first photo otherwise
    np.testing.assert_allclose(np.sort(known[0]), 2.5003 * np.sort([0.1, np.sqrt(0.02), upright]), rtol=2e-3)
    longest = Rotation.from_quat(found.wxyz, scalar_first=True).as_matrix()[
        np.arange(9), :, found.semi_axes.argmax(axis=1)
    ]
    np.testing.assert_allclose(np.abs(longest[1:]), np.tile([0, 0, 1], (8, 1)), atol=1e-6)


def test_nothing_is_drawn_where_nothing_is_known() -> None:
    assert len(ellipsoids(np.zeros((0, 3)), np.zeros((0, 3, 3))).wxyz) == 0
