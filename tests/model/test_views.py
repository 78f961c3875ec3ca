# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from skymoor.model import RenderOptions, nadir_view, oblique_views, tiles


def cloud(low: tuple[float, float, float], high: tuple[float, float, float], n: int = 50_000) -> np.ndarray:
    return np.random.default_rng(0).uniform(low, high, (n, 3))


def test_covers_the_points_with_north_up() -> None:
    points = cloud((-3, -2, 0), (5, 4, 0.3))
    view = nadir_view(points, 0.01)
    assert view.pixel == 0.01
    rows, columns = view.shape
    assert abs(columns * view.pixel - 8) < 0.1 and abs(rows * view.pixel - 6) < 0.1
    np.testing.assert_allclose(view.view_from_level, np.diag([1.0, -1.0, -1.0]))
    assert view.x0 == pytest.approx(-3, abs=0.05)
    assert view.y0 == pytest.approx(-4, abs=0.05)  # y of the view goes down: its start is the largest y of the level


def test_a_points_pixel_is_where_the_ray_is() -> None:
    view = nadir_view(cloud((-3, -2, 0), (5, 4, 0.3)), 0.01)
    xyz_level = np.array([1.234, 0.567, 0.2])
    x, y, _ = view.view_from_level @ xyz_level
    u, v = (x - view.x0) / view.pixel, (y - view.y0) / view.pixel
    np.testing.assert_allclose([view.x0 + u * view.pixel, -(view.y0 + v * view.pixel)], xyz_level[:2], atol=1e-12)
    assert 0 < u < view.shape[1] and 0 < v < view.shape[0]
    assert v == pytest.approx((4 - 0.567) / 0.01, abs=5)


def test_size_is_bounded_and_the_pixel_never_finer_than_the_photos() -> None:
    points = cloud((-3, -2, 0), (5, 4, 0.3))
    large = nadir_view(points, 1e-5, RenderOptions(max_px=200))
    assert max(large.shape) in (200, 201)
    assert large.pixel == pytest.approx(8 / 200, rel=0.01)
    assert nadir_view(points, 0.5).pixel == 0.5


def test_a_few_outliers_do_not_stretch_the_view() -> None:
    points = cloud((-3, -2, 0), (5, 4, 0.3))
    points[:20] = 1000.0
    points[20:40] = -1000.0
    view = nadir_view(points, 0.01)
    assert view.shape[1] * view.pixel < 8.1


def test_eight_obliques_look_down_from_all_sides_and_hold_the_site() -> None:
    points = cloud((-3, -2, 0), (5, 4, 0.3))
    views = oblique_views(points, 0.01)
    looks = np.array([view.view_from_level[2] for view in views])
    assert len(views) == 8
    np.testing.assert_allclose(looks[:, 2], -np.sqrt(0.5), atol=1e-12)
    azimuths = np.degrees(np.arctan2(looks[:, 0], looks[:, 1])) % 360
    np.testing.assert_allclose(azimuths, np.arange(8) * 45, atol=1e-9)
    for view in views:
        assert np.linalg.det(view.view_from_level) == pytest.approx(1)
        assert view.view_from_level[0, 2] == pytest.approx(0)  # the horizon is level in the picture
        assert view.view_from_level[1, 2] < 0  # and up is up
        xy = (points @ view.view_from_level.T)[:, :2] - [view.x0, view.y0]
        inside = ((xy >= 0) & (xy <= np.array(view.shape[::-1]) * view.pixel)).all(axis=1)
        assert 0.98 < inside.mean() <= 1


def test_the_papers_renders_have_729_tiles() -> None:
    found = tiles((2048, 2048))
    assert 9 * len(found) == 729
    assert {(rows.stop - rows.start, columns.stop - columns.start) for rows, columns in found} == {(300, 300)}


@pytest.mark.parametrize("shape", [(2048, 1500), (299, 900), (300, 301), (40, 50)])
def test_tiles_cover_every_pixel(shape: tuple[int, int]) -> None:
    covered = np.zeros(shape, dtype=int)
    for window in tiles(shape):
        covered[window] += 1
    assert covered.min() >= 1
    assert covered.max() <= 9
