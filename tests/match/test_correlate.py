# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.match.channels import ChannelOptions, Channels, crop_channels, make_channels
from skymoor.match.correlate import Target, correlate, parabola, peaks
from skymoor.types import Raster
from support.pictures import noise_picture

Array32 = NDArray[np.float32]


def channels_of(shape: tuple[int, int], seed: int = 0) -> Channels:
    rgb = noise_picture(shape, seed=seed)
    return make_channels(Raster(rgb, np.ones(shape, bool)), ChannelOptions())


def part(channels: Channels, v0: int, u0: int, h: int, w: int) -> Channels:
    window = (slice(None), slice(v0, v0 + h), slice(u0, u0 + w))
    return Channels(channels.values[window], channels.known[window])


def best(scores: Array32) -> tuple[float, float, float]:
    return next(peaks(scores, count=1, apart=1))


TARGET = channels_of((120, 160))


@pytest.mark.parametrize(("v0", "u0"), [(0, 0), (37, 81), (70, 100)])
def test_a_planted_shift_comes_back(v0: int, u0: int) -> None:
    template = part(TARGET, v0, u0, 50, 60)
    scores = correlate(template, Target(TARGET), min_overlap=0.5)
    assert scores.shape == (169, 219)
    v, u, score = best(scores)
    assert v - 49 == pytest.approx(v0, abs=0.1) and u - 59 == pytest.approx(u0, abs=0.1)
    # The score of a perfect agreement is the root of the overlap; all other places are far below.
    assert score == pytest.approx(np.sqrt(template.known[0].sum()), rel=0.02)
    scores[int(v) - 8 : int(v) + 9, int(u) - 8 : int(u) + 9] = -np.inf
    assert scores.max() < 0.4 * score


def test_valid_shifts_are_a_window_of_all_shifts() -> None:
    template = part(TARGET, 20, 30, 50, 60)
    target = Target(TARGET)
    full, valid = (correlate(template, target, min_overlap=0.5, valid=v) for v in (False, True))
    assert valid.shape == (71, 101)
    np.testing.assert_allclose(valid, full[49:120, 59:160], rtol=1e-3, atol=1e-3)
    v, u, _ = best(valid)
    assert (round(v), round(u)) == (20, 30)


def test_scores_of_unrelated_pictures_are_those_of_chance() -> None:
    template = channels_of((60, 60), seed=5)
    scores = correlate(template, Target(TARGET), min_overlap=0.6)
    known = scores[np.isfinite(scores)]
    assert abs(known.mean()) < 2
    assert 1 < known.max() < 0.35 * 60


def test_overlap_rule() -> None:
    template = part(TARGET, 0, 0, 50, 60)
    scores = correlate(template, Target(TARGET), min_overlap=0.5)
    # The template's first pixel at (v - 49, u - 59): half of it must lie on the target.
    rows = 50 - np.abs(np.clip(np.arange(169) - 49, None, 0)) - np.clip(np.arange(169) - 119, 0, None)
    columns = 60 - np.abs(np.clip(np.arange(219) - 59, None, 0)) - np.clip(np.arange(219) - 159, 0, None)
    overlap = rows[:, None] * columns[None]
    # Two pixels of border are unknown on all sides.
    assert np.isinf(scores[overlap < 0.4 * 3000]).all()
    assert np.isfinite(scores[overlap > 0.65 * 3000]).all()
    assert (scores[np.isinf(scores)] < 0).all()


def test_masked_parts_of_the_target_are_not_compared() -> None:
    known = TARGET.known.copy()
    known[:, :, 100:] = 0
    masked = Channels(TARGET.values * known[:1], known)
    inside = part(TARGET, 30, 20, 50, 60)
    v, u, score = best(correlate(inside, Target(masked), min_overlap=0.5))
    assert (round(v) - 49, round(u) - 59) == (30, 20)
    assert score == pytest.approx(np.sqrt(inside.known[0].sum()), rel=0.02)
    # Two thirds of this template lie on the masked part: the place is out of reach, though the pixels are there.
    beyond = part(TARGET, 30, 80, 50, 60)
    v, u, score = best(correlate(beyond, Target(masked), min_overlap=0.5))
    assert (round(v) - 49, round(u) - 59) != (30, 80)
    assert score < 0.5 * np.sqrt(beyond.known[0].sum())


def test_masked_parts_of_the_template_are_not_compared() -> None:
    template = part(TARGET, 30, 20, 50, 60)
    known = template.known.copy()
    known[:, :, 35:] = 0
    masked = Channels(template.values * known[:1], known)
    v, u, score = best(correlate(masked, Target(TARGET), min_overlap=0.5))
    assert (round(v) - 49, round(u) - 59) == (30, 20)
    assert 0.6 * np.sqrt(known[0].sum()) < score < 1.02 * np.sqrt(known[0].sum())


def test_a_target_without_content_has_no_place() -> None:
    nothing = Channels(np.zeros_like(TARGET.values), np.ones_like(TARGET.known))
    scores = correlate(part(TARGET, 0, 0, 50, 60), Target(nothing), min_overlap=0.5)
    assert not (scores > 1).any()


def test_peaks_are_apart_and_exact() -> None:
    v, u = np.mgrid[0:40, 0:50].astype(np.float32)
    surface = 10 - 0.1 * ((v - 12.3) ** 2 + (u - 30.7) ** 2)
    surface = np.maximum(surface, 8 - 0.1 * ((v - 33) ** 2 + (u - 8) ** 2))
    first, second = peaks(surface, count=2, apart=12)
    assert first[:2] == pytest.approx((12.3, 30.7), abs=1e-3)
    assert second[:2] == pytest.approx((33, 8), abs=1e-3)
    assert list(peaks(np.full((5, 5), -np.inf, np.float32), count=3, apart=1)) == []


def test_parabola() -> None:
    assert parabola(np.float32([1, 2, 1])) == 0
    assert parabola(np.float32([-(1.2**2), -(0.2**2), -(0.8**2)])) == pytest.approx(0.2, abs=1e-6)
    assert parabola(np.float32([1, 2])) == 0
    assert parabola(np.float32([-np.inf, 2, 1])) == 0
    assert parabola(np.float32([2, 2, 2])) == 0


def test_cut_is_zero_beyond_the_picture() -> None:
    window = crop_channels(TARGET, 150, -5, 20)
    np.testing.assert_array_equal(window.values[:, 5:, :10], TARGET.values[:, :15, 150:])
    assert not window.values[:, :5].any() and not window.known[:, :, 10:].any()
    assert not crop_channels(TARGET, 500, 500, 20).values.any()
