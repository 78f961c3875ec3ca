# SPDX-License-Identifier: Apache-2.0
"""Pictures that lie nowhere keep all but the layout, and score as chance does; the true one stands out."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.match import DecoyOptions, SearchOptions, decoy_scores, search_hypotheses
from skymoor.match.decoys import SEAM_PX, make_decoys, mirrored, mixed
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


def test_of_a_mixed_picture_no_part_stays(rng: np.random.Generator) -> None:
    a = picture((45, 62), 1)
    decoy = mixed(a, 3, rng)
    assert not decoy.mask[:, 60:].any() and not decoy.mask[::15].any()
    assert decoy.height is not None and not np.isfinite(decoy.height[~decoy.mask]).any()
    homes = []
    for k in range(9):
        top, left = 15 * (k // 3), 20 * (k % 3)
        part = decoy.rgb[top : top + 15, left : left + 20]
        assert decoy.mask[top + SEAM_PX : top + 15 - SEAM_PX, left + SEAM_PX : left + 20 - SEAM_PX].all()
        (home,) = (j for j in range(9) if (part == a.rgb[15 * (j // 3) :, 20 * (j % 3) :][:15, :20]).all())
        assert home != k
        homes.append(home)
    assert sorted(homes) == list(range(9))


def test_there_are_as_many_as_asked_for_and_the_first_is_whole(rng: np.random.Generator) -> None:
    a = picture((40, 60), 2)
    decoys = list(make_decoys(a, DecoyOptions(count=5), rng))
    assert len(decoys) == 5
    np.testing.assert_array_equal(decoys[0].rgb, mirrored(a).rgb)
    assert all((decoy.rgb != decoys[0].rgb).any() for decoy in decoys[1:])


def test_the_true_picture_stands_out(rng: np.random.Generator) -> None:
    """A window of the reference is found where it is; its decoys score as one of another place does."""
    b, elsewhere = picture((220, 260), 3), picture((120, 140), 9)
    a = Raster(b.rgb[50:170, 60:200].copy(), b.mask[50:170, 60:200], b.height[50:170, 60:200])  # type: ignore[index]
    scales = {"min_scale": 0.9, "max_scale": 1.1}
    true = search_hypotheses(a, b, **scales, options=OPTIONS)[0]
    assert np.linalg.norm(np.array(true.centre_px) - [130, 110]) < 2
    chance = decoy_scores(a, b, **scales, options=OPTIONS, decoys=DecoyOptions(count=3), rng=rng)
    other = search_hypotheses(elsewhere, b, **scales, options=OPTIONS)[0].score
    assert len(chance) == 3
    assert true.score > 2.5 * max(chance)
    assert 0.6 * other < np.mean(chance) < 1.5 * other


def test_no_decoy_fits_into_a_reference_that_is_too_small(rng: np.random.Generator) -> None:
    a, b = picture((200, 200), 0), picture((20, 20), 1)
    assert decoy_scores(a, b, min_scale=1.0, max_scale=2.0, options=OPTIONS, rng=rng) == []


@pytest.mark.parametrize("parts", [1, 2])
def test_few_parts(parts: int, rng: np.random.Generator) -> None:
    assert mixed(picture((30, 30), 4), parts, rng).mask.any()


def test_no_more_decoys_than_are_asked_for(rng: np.random.Generator) -> None:
    a, b = picture((60, 80), 2), picture((120, 140), 3)
    asked: list[list[float]] = []

    def enough(scores: object) -> bool:
        asked.append(list(scores))  # type: ignore[call-overload]
        return len(asked) == 2

    limits = {"min_scale": 0.9, "max_scale": 1.1}
    found = decoy_scores(a, b, **limits, options=OPTIONS, decoys=DecoyOptions(count=5), rng=rng, enough=enough)
    assert [len(scores) for scores in asked] == [2, 3]
    assert len(found) == 3 and found == asked[-1]
