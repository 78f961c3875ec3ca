# SPDX-License-Identifier: Apache-2.0
"""Scale bar and north arrow that are drawn into images."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.results.report.scale import with_scale


@pytest.mark.parametrize(("pixel_m", "wanted_m"), [(0.1, 10.0), (0.35, 20.0), (2.0, 200.0)])
def test_the_bar_is_a_round_length(pixel_m: float, wanted_m: float) -> None:
    grey = np.full((300, 400, 3), 90, np.uint8)
    drawn = with_scale(grey, pixel_m)
    (foot,) = np.nonzero((drawn[-10] > 200).all(axis=1))
    assert (np.ptp(foot)) * pixel_m == pytest.approx(wanted_m, abs=3 * pixel_m)
    assert (drawn[8:30, 370:395] > 200).any() and (grey == 90).all()  # the arrow; the given image is left alone


def test_a_small_image_is_left_as_it_is() -> None:
    small = np.full((60, 400, 3), 90, np.uint8)
    assert with_scale(small, 1.0) is small
