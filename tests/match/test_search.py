# SPDX-License-Identifier: Apache-2.0
"""Pictures of known heading, scale and place must be found in a reference of another day; others must not."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.match import ImageHypothesis, search_hypotheses
from skymoor.match.hypothesis import distinct, equivalent
from skymoor.types import Raster
from support.pictures import GRID, Overhead, another_day, seen_through, without_heights


@pytest.fixture(scope="module")
def reference(other_day: Overhead) -> Raster:
    return another_day(seen_through(other_day, lambda px: px, GRID.shape))


def placed(view: Overhead, truth: ImageHypothesis, shape: tuple[int, int]) -> Raster:
    matrix = truth.matrix(shape)
    raster = seen_through(view, lambda px: px @ matrix[:, :2].T + matrix[:, 2], shape)
    assert raster.height is not None
    return Raster(raster.rgb, raster.mask, (raster.height / np.float32(truth.scale)).astype(np.float32))


CASES = {
    "fine pixels": (ImageHypothesis(0.6, np.radians(33.0), (110.3, 105.6), 0.0), (140, 180)),
    "coarse pixels": (ImageHypothesis(1.3, np.radians(200.0), (125.5, 90.2), 0.0), (70, 80)),
    "finest pixels": (ImageHypothesis(0.45, np.radians(301.7), (140.0, 115.0), 0.0), (160, 180)),
}


@pytest.mark.parametrize(
    ("case", "heights"),
    [("fine pixels", True), ("fine pixels", False), ("coarse pixels", True), ("finest pixels", True)],
)
def test_an_image_is_found(reference: Raster, first_day: Overhead, case: str, heights: bool) -> None:
    truth, shape = CASES[case]
    a, b = placed(first_day, truth, shape), reference
    if not heights:
        a, b = without_heights(a), without_heights(b)
    steps: list[tuple[int, int]] = []
    found = search_hypotheses(
        a,
        b,
        min_scale=truth.scale / 1.1,
        max_scale=truth.scale * 1.15,
        progress=lambda done, of: steps.append((done, of)),
    )
    first = found[0]
    turn = (first.azimuth_rad - truth.azimuth_rad + np.pi) % (2 * np.pi) - np.pi
    assert abs(np.degrees(turn)) < 1.0
    assert abs(first.scale / truth.scale - 1) < 0.025  # dense matches correct that
    assert np.hypot(*(np.array(first.centre_px) - truth.centre_px)) < 0.5
    # Far above decoys and the second hypothesis, though crossings resemble each other; a registration requires 40
    # and 1.3 times the second. Not above what agreement of every pixel would give.
    assert 40 < first.score < np.sqrt(a.mask.sum() * truth.scale**2)
    assert all(first.score > 1.4 * other.score for other in found[1:])
    assert [p.score for p in found] == sorted((p.score for p in found), reverse=True)
    assert steps[-1][0] == steps[-1][1] and [done for done, _ in steps] == sorted(done for done, _ in steps)


def test_another_site_scores_like_decoys(reference: Raster, next_door: Overhead) -> None:
    truth, shape = CASES["fine pixels"]
    found = search_hypotheses(placed(next_door, truth, shape), reference, min_scale=0.53, max_scale=0.7)
    # Streets and roofs resemble each other; 40 is the least that a registration asks for.
    assert 8 < found[0].score < 40
    assert found[0].score < 1.3 * found[1].score


def test_an_image_larger_than_the_reference_has_no_hypothesis(reference: Raster, first_day: Overhead) -> None:
    truth, shape = CASES["fine pixels"]
    a = placed(first_day, truth, shape)
    assert search_hypotheses(a, reference, min_scale=6.0, max_scale=9.0) == []


def test_matrix_is_the_definition() -> None:
    hypothesis = ImageHypothesis(0.5, np.radians(90), (40.0, 30.0), 1.0)
    matrix = hypothesis.matrix((60, 80))
    # The middle lies at the place; u of the picture runs along v of the reference.
    np.testing.assert_allclose(matrix @ [40, 30, 1], [40, 30])
    np.testing.assert_allclose(matrix @ [41, 30, 1], [40, 30.5], atol=1e-12)
    np.testing.assert_allclose(matrix @ [40, 31, 1], [39.5, 30], atol=1e-12)


def test_distinct_keeps_the_best_of_neighbours() -> None:
    shape = (100, 100)
    here = ImageHypothesis(1.0, 0.0, (50.0, 50.0), 10.0)
    nearly = ImageHypothesis(1.05, np.radians(-5.0 + 360), (52.0, 49.0), 12.0)
    turned = ImageHypothesis(1.0, np.radians(40), (50.0, 50.0), 8.0)
    away = ImageHypothesis(1.0, 0.0, (80.0, 50.0), 11.0)
    larger = ImageHypothesis(1.3, 0.0, (50.0, 50.0), 9.0)
    assert distinct([here, nearly, turned, away, larger], shape) == [nearly, away, larger, turned]
    assert equivalent(here, nearly, shape) and not equivalent(here, turned, shape)
