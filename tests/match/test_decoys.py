# SPDX-License-Identifier: Apache-2.0
"""Pictures that lie nowhere keep all but the layout, and score as chance does; the true one stands out."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.match import DecoyOptions, SearchOptions, decoy_scores, search_hypotheses
from skymoor.match.decoys import make_decoys, mirrored, stretched
from skymoor.types import Raster
from support.pictures import noise_picture

OPTIONS = SearchOptions(azimuth_step_deg=10.0, template_px=64, reference_px=160, fine_px=120)


def picture(shape: tuple[int, int], seed: int) -> Raster:
    grey = noise_picture(shape, seed=seed)
    return Raster(grey, np.ones(shape, bool), (grey[..., 0] / 20.0).astype(np.float32))


def test_a_mirrored_picture_is_mirrored_once() -> None:
    a = picture((40, 60), 0)
    decoy = mirrored(a)
    np.testing.assert_array_equal(decoy.rgb[:, ::-1], a.rgb)
    assert decoy.height is not None and a.height is not None
    np.testing.assert_array_equal(decoy.height[:, ::-1], a.height)
    np.testing.assert_array_equal(mirrored(decoy).rgb, a.rgb)


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, 135.0])
def test_a_stretched_picture_is_longer_along_its_direction(direction_deg: float) -> None:
    """Four marks at known places come out where the stretch takes them, with their heights; the area stays."""
    rgb, height = np.zeros((80, 120, 3), np.uint8), np.zeros((80, 120), np.float32)
    marks = np.array([[20, 15], [95, 20], [25, 65], [90, 60]])
    for k, (u, v) in enumerate(marks):
        rgb[v - 2 : v + 3, u - 2 : u + 3], height[v - 2 : v + 3, u - 2 : u + 3] = 255, k + 1
    mask = np.ones((80, 120), bool)
    decoy = stretched(Raster(rgb, mask, height), 1.2, np.radians(direction_deg))
    assert decoy.height is not None
    found = np.array([np.argwhere(decoy.height == k + 1).mean(axis=0)[::-1] for k in range(4)])
    along = np.array([np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))])
    for direction, factor in ((along, 1.2), (along[::-1] * [-1, 1], 1 / 1.2)):
        moved, before = np.diff(found @ direction), np.diff(marks @ direction)
        assert moved == pytest.approx(factor * before, abs=1.2)
    assert (decoy.rgb[tuple(np.round(found[:, ::-1]).astype(int).T)] > 200).all()
    assert decoy.mask.sum() == pytest.approx(mask.sum(), rel=0.02)
    assert np.isnan(decoy.height[~decoy.mask]).all()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_there_are_as_many_as_asked_for_and_all_differ(count: int) -> None:
    a = picture((40, 60), 2)
    decoys = list(make_decoys(a, DecoyOptions(count=count)))
    assert len(decoys) == count
    np.testing.assert_array_equal(decoys[0].rgb, mirrored(a).rgb)
    assert len({decoy.rgb.tobytes() for decoy in decoys}) == count


def test_the_true_picture_stands_out() -> None:
    """A window of the reference is found where it is; its decoys score as one of another place does."""
    b, elsewhere = picture((220, 260), 3), picture((120, 140), 9)
    a = Raster(b.rgb[50:170, 60:200].copy(), b.mask[50:170, 60:200], b.height[50:170, 60:200])  # type: ignore[index]
    scales = {"min_scale": 0.9, "max_scale": 1.1}
    true = search_hypotheses(a, b, **scales, options=OPTIONS)[0]
    assert np.linalg.norm(np.array(true.centre_px) - [130, 110]) < 2
    chance = decoy_scores(a, b, **scales, options=OPTIONS, decoys=DecoyOptions(count=3))
    other = search_hypotheses(elsewhere, b, **scales, options=OPTIONS)[0].score
    assert len(chance) == 3
    assert true.score > 2.5 * max(chance)
    assert 0.6 * other < np.mean(chance) < 1.5 * other


def test_no_decoy_fits_into_a_reference_that_is_too_small() -> None:
    a, b = picture((200, 200), 0), picture((20, 20), 1)
    assert decoy_scores(a, b, min_scale=1.0, max_scale=2.0, options=OPTIONS) == []


def test_no_more_decoys_than_are_asked_for() -> None:
    a, b = picture((60, 80), 2), picture((120, 140), 3)
    asked: list[list[float]] = []

    def enough(scores: object) -> bool:
        asked.append(list(scores))  # type: ignore[call-overload]
        return len(asked) == 2

    limits = {"min_scale": 0.9, "max_scale": 1.1}
    found = decoy_scores(a, b, **limits, options=OPTIONS, decoys=DecoyOptions(count=5), enough=enough)
    assert [len(scores) for scores in asked] == [2, 3]
    assert len(found) == 3 and found == asked[-1]
