# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.match import CyclicOptions, cyclic_matches
from skymoor.match.cyclic import cycle_error_px
from skymoor.types import Array32, Matches2D, Warp

Array = NDArray[np.float64]
SHAPE = (60, 80)
SHIFT = np.array([3.25, -2.5])


def centres(shape: tuple[int, int] = SHAPE) -> Array:
    return np.stack(np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5), axis=-1)


def shifted(confidence: float = 1.0) -> Warp:
    """What is at p in a is at p + SHIFT in b."""
    sure: Array32 = np.full(SHAPE, confidence, np.float32)
    there, back = centres() + SHIFT, centres() - SHIFT
    return Warp(there.astype(np.float32), sure, back.astype(np.float32), sure.copy())


def matched(warp: Warp, **options: float) -> Matches2D:
    chosen = CyclicOptions(**{"max_matches": 10**6, **options})  # type: ignore[arg-type]
    return cyclic_matches(warp, chosen, rng=np.random.default_rng(0))


def test_a_consistent_warp_has_no_error() -> None:
    error = cycle_error_px(shifted())
    assert error.shape == SHAPE
    assert error[4:-4, 4:-5].max() < 1e-4
    assert np.isinf(error[:, -4:]).all()  # beyond the right border of b


def test_matches_are_pixel_centres_and_where_they_go() -> None:
    matches = matched(shifted())
    np.testing.assert_array_equal(matches.px_a % 1, 0.5)
    np.testing.assert_allclose(matches.px_b - matches.px_a, np.tile(SHIFT, (len(matches), 1)), atol=1e-5)
    # All pixels whose place in b lies between its pixel centres.
    assert len(matches) == (80 - 4) * (60 - 3)
    assert (matches.confidence == 1).all()


def test_a_wrong_region_does_not_return() -> None:
    warp = shifted()
    there = warp.b_from_a.copy()
    there[20:30, 30:50] += [15, 12]
    matches = matched(replace(warp, b_from_a=there))
    u, v = matches.px_a.T
    assert not ((v > 20) & (v < 30) & (u > 30) & (u < 50)).any()
    assert len(matches) == (80 - 4) * (60 - 3) - 200


def test_a_wrong_region_of_the_way_back_is_rejected_too() -> None:
    warp = shifted()
    back = warp.a_from_b.copy()
    back[20:30, 30:50] -= 9
    u, v = matched(replace(warp, a_from_b=back)).px_b.T
    assert not ((v > 21) & (v < 29) & (u > 31) & (u < 49)).any()


@pytest.mark.parametrize(("drift", "kept"), [(1.9, True), (2.1, False)])
def test_threshold_is_in_pixels(drift: float, kept: bool) -> None:
    warp = shifted()
    u_only = replace(warp, a_from_b=warp.a_from_b + np.float32([drift, 0]))
    v_only = replace(warp, a_from_b=warp.a_from_b + np.float32([0, drift]))
    for drifted in (u_only, v_only):
        assert (len(matched(drifted)) > 3000) == kept
        assert (len(matched(drifted)) == 0) == (not kept)


def test_either_direction_can_doubt() -> None:
    sure = np.ones(SHAPE, np.float32)
    doubt = sure.copy()
    doubt[:, :40] = 0.1
    warp = shifted()
    of_a = matched(replace(warp, confidence_a=doubt))
    assert (of_a.px_a[:, 0] > 40).all() and len(of_a) > 1000
    of_b = matched(replace(warp, confidence_b=doubt))
    assert (of_b.px_b[:, 0] > 39.5).all() and len(of_b) > 1000
    assert of_b.confidence.min() >= 0.2
    assert len(matched(shifted(0.19))) == 0 and len(matched(shifted(0.21))) > 0


def test_many_matches_are_drawn_at_random_and_repeatably() -> None:
    options = CyclicOptions(max_matches=500)
    a, b, c = (cyclic_matches(shifted(), options, rng=np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert len(a) == 500 == len(np.unique(a.px_a, axis=0))
    np.testing.assert_array_equal(a.px_a, b.px_a)
    assert not np.array_equal(a.px_a, c.px_a)
    # From everywhere.
    assert np.abs(a.px_a.mean(axis=0) - [38, 32]).max() < 4


def test_no_matches_are_an_empty_answer() -> None:
    assert len(matched(shifted(0.0))) == 0
    assert matched(shifted(0.0)).px_b.shape == (0, 2)
