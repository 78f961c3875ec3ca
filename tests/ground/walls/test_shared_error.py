# SPDX-License-Identifier: Apache-2.0
"""What the matches of one wall share is in the predicted accuracy, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geo import ce90_m, le90_m
from skymoor.geometry import point_covariance
from skymoor.ground.walls.shared_error import WALL_SIGMA_M, with_shared_error
from skymoor.types import Registration


def test_it_widens_the_horizontal_error_of_every_camera_alike() -> None:
    formal = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 0.01, 0.01, 0.04])
    found = with_shared_error(Registration(registered=True, reason="", enu_from_level=None, covariance=formal))
    assert found.covariance is not None
    cameras = [[0.0, 0.0, 0.0], [30.0, -20.0, 5.0]]
    before, after = (point_covariance(one, np.zeros(3), cameras) for one in (formal, found.covariance))
    np.testing.assert_allclose(after - before, np.broadcast_to(np.diag([WALL_SIGMA_M**2] * 2 + [0.0]), (2, 3, 3)))
    assert ce90_m(after[0]) == pytest.approx(2.146 * np.hypot(WALL_SIGMA_M, 0.1), rel=1e-3)
    assert le90_m(after[0]) == pytest.approx(le90_m(before[0]))
    assert formal[4, 4] == 0.01  # the formal one is as it was


def test_without_a_covariance_there_is_nothing_to_widen() -> None:
    refused = Registration(registered=False, reason="no transform", enu_from_level=None)
    assert with_shared_error(refused) is refused
