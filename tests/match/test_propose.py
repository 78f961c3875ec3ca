# SPDX-License-Identifier: Apache-2.0
"""Local features propose the place of an image in a map of another day, and of its mirror image none that counts."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.match.features import TILE_PX, features_of, nearest
from skymoor.match.propose import propose
from skymoor.match.reference_pyramid import ReferencePyramid
from skymoor.match.search import DECISIVE, SearchOptions, search_in
from skymoor.types import Raster, no_progress
from support.textured import cut, textured

LIMITS = {"min_scale": 0.3, "max_scale": 1.5}


@pytest.fixture(scope="module")
def wide() -> Raster:
    """Wider than a tile."""
    return textured((900, TILE_PX + 500), 1)


@pytest.mark.parametrize(
    ("scale", "azimuth_deg", "centre"),
    [(0.5, 40.0, (300.0, 420.0)), (1.0, 200.0, (float(TILE_PX), 500.0)), (0.8, 310.0, (1300.0, 450.0))],
)
def test_the_place_is_proposed(wide: Raster, scale: float, azimuth_deg: float, centre: tuple[float, float]) -> None:
    best, *others = propose(cut(wide, scale, azimuth_deg, centre), features_of(wide), **LIMITS, count=5)
    assert best.scale == pytest.approx(scale, rel=0.01)
    assert abs((np.degrees(best.azimuth_rad) - azimuth_deg + 180) % 360 - 180) < 0.5
    assert np.hypot(*np.subtract(best.centre_px, centre)) < 1.0
    assert best.inliers >= 3 * DECISIVE and all(one.inliers < DECISIVE for one in others)


def test_another_place_proposes_nothing_decisive(wide: Raster) -> None:
    other = cut(textured((900, 900), 2), 0.5, 40.0, (450.0, 450.0))
    found = propose(other, features_of(wide), **LIMITS, count=5)
    assert all(one.inliers < DECISIVE for one in found)
    assert [one.inliers for one in found] == sorted((one.inliers for one in found), reverse=True)
    # Nor is the right one where its scale is not searched.
    limited = propose(cut(wide, 0.5, 0.0, (400.0, 400.0)), features_of(wide), min_scale=0.9, max_scale=1.5, count=5)
    assert all(one.inliers < DECISIVE and one.scale > 0.8 for one in limited)


def test_features_are_the_same_with_and_without_a_border_between_tiles(wide: Raster) -> None:
    part = Raster(wide.rgb[:, 600:1400], wide.mask[:, 600:1400])
    whole, own = features_of(wide), features_of(part)
    near = np.abs(whole.px[:, 0] - TILE_PX) < 40
    gaps = np.linalg.norm(whole.px[near, None] - (own.px + [600.0, 0.0])[None], axis=2).min(axis=1)
    assert near.sum() > 50 and (gaps < 0.01).mean() > 0.9


def test_nothing_is_found_where_nothing_is_known() -> None:
    blank = Raster(np.zeros((200, 200, 3), np.uint8), np.zeros((200, 200), bool))
    assert len(features_of(blank)) == 0
    assert propose(textured((200, 200), 0), features_of(blank), **LIMITS, count=3) == []


def test_neighbours_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch, wide: Raster) -> None:
    """Compared in blocks as at once."""
    reference, own = features_of(wide), features_of(cut(wide, 0.8, 0.0, (500.0, 450.0)))
    alike = own.descriptors.astype(float) @ reference.descriptors.astype(float).T
    monkeypatch.setattr("skymoor.match.features.BLOCK", 100)
    found = np.take_along_axis(alike, nearest(own, reference, 3), axis=1)
    np.testing.assert_array_equal(found, -np.sort(-alike, axis=1)[:, :3])


def test_a_decisive_place_is_refined_and_nothing_else_searched(wide: Raster) -> None:
    calls: list[tuple[int, int]] = []
    image, pyramid = cut(wide, 0.5, 40.0, (300.0, 420.0)), ReferencePyramid(wide)

    def count(done: int, total: int, note: str = "", /) -> None:
        calls.append((done, total))

    best = search_in(pyramid, image, **LIMITS, options=SearchOptions(), progress=count)[0]
    assert best.by_features and calls == [(1, 1)]
    assert best.scale == pytest.approx(0.5, rel=0.02)
    assert np.hypot(*np.subtract(best.centre_px, (300.0, 420.0))) < 2.0
    options = SearchOptions(azimuth_step_deg=60.0, scale_step=1.5)
    other = search_in(pyramid, image, **LIMITS, options=options, progress=no_progress, by_features=False)[0]
    assert not other.by_features
