# SPDX-License-Identifier: Apache-2.0
"""What changed between two surfaces: known changes come back, and errors of the registration do not."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.transform import Affine
from scipy.ndimage import gaussian_filter, shift

from skymoor.results.changes import HeightChanges, _figure, _geojson, height_changes
from skymoor.results.report.renderings import difference_figure
from skymoor.types import Array32

PIXEL_M = 0.25
PLAN_SIGMA_M, HEIGHT_SIGMA_M, NOISE_M = 0.3, 0.1, 0.08
HOUSE = np.s_[100:160, 100:180]  # 15 x 20 m, 8 m high
SHED = np.s_[250:266, 60:84]  # 4 x 6 m, 3 m high
PIT = np.s_[300:340, 250:290]  # 10 x 10 m, 2 m deep


def surface(rng: np.random.Generator) -> Array32:
    ground = 30 * gaussian_filter(rng.normal(size=(400, 400)), 40)
    ground[HOUSE] += 8.0
    return ground.astype(np.float32)


def measured(true: Array32, rng: np.random.Generator, *, moved_m: tuple[float, float] = (0, 0), up_m: float = 0):
    """The surface with the noise of a model, displaced by errors of its registration."""
    noise = gaussian_filter(rng.normal(size=true.shape), 1.0)
    there = shift(true, np.array(moved_m) / PIXEL_M, order=1, mode="nearest")
    return (there + up_m + NOISE_M * noise / noise.std()).astype(np.float32)


def compared(earlier: Array32, later: Array32) -> HeightChanges:
    sigmas = {"plan_sigma_m": PLAN_SIGMA_M, "height_sigma_m": HEIGHT_SIGMA_M}
    return height_changes(earlier, later, PIXEL_M, **sigmas)


def volume(found: HeightChanges, part: tuple[slice, slice]) -> float:
    inside = np.zeros(found.areas.shape, bool)
    inside[part] = True
    numbers = np.unique(found.areas[inside & (found.areas > 0)])
    return float(found.difference[np.isin(found.areas, numbers)].sum() * PIXEL_M**2) if len(numbers) else 0.0


def test_what_was_built_and_dug_comes_back_with_its_volume() -> None:
    rng = np.random.default_rng(1)
    before = surface(rng)
    after = before.copy()
    after[SHED] += 3.0
    after[PIT] -= 2.0
    found = compared(measured(before, rng), measured(after, rng, moved_m=(0.3, -0.2), up_m=0.1))
    assert found.areas.max() == 2
    assert volume(found, SHED) == pytest.approx(24 * 3.0, rel=0.15)
    assert volume(found, PIT) == pytest.approx(-100 * 2.0, rel=0.15)
    # And the other way round.
    back = compared(measured(after, rng), measured(before, rng))
    assert back.areas.max() == 2
    assert volume(back, SHED) == pytest.approx(-24 * 3.0, rel=0.15)
    assert volume(back, PIT) == pytest.approx(100 * 2.0, rel=0.15)


def test_a_house_that_is_gone_is_one_area() -> None:
    rng = np.random.default_rng(2)
    before = surface(rng)
    after = before.copy()
    after[HOUSE] -= 8.0
    found = compared(measured(before, rng), measured(after, rng))
    assert found.areas.max() == 1
    assert volume(found, HOUSE) == pytest.approx(-300 * 8.0, rel=0.1)


def test_errors_of_the_registration_are_no_change() -> None:
    rng = np.random.default_rng(3)
    false = 0
    for _ in range(20):
        true = surface(rng)
        moved = rng.normal(0, PLAN_SIGMA_M, 2)
        off = {"moved_m": tuple(moved), "up_m": float(rng.normal(0, HEIGHT_SIGMA_M))}
        false += int(compared(measured(true, rng), measured(true, rng, **off)).areas.max())
    assert false <= 4  # a displacement exceeds CE90 in one of ten


def test_a_displacement_far_beyond_the_stated_accuracy_shows() -> None:
    rng = np.random.default_rng(4)
    true = surface(rng)
    found = compared(measured(true, rng), measured(true, rng, moved_m=(3.0, 0.0)))
    assert found.areas.max() >= 2  # both sides of the house


def test_the_limit_follows_noise_and_accuracy() -> None:
    rng = np.random.default_rng(5)
    true = surface(rng)
    found = compared(measured(true, rng), measured(true, rng))
    assert found.limit_m == pytest.approx(3.29 * np.hypot(np.sqrt(2) * NOISE_M, HEIGHT_SIGMA_M), rel=0.1)
    assert found.plan_m == pytest.approx(2.146 * PLAN_SIGMA_M + PIXEL_M, rel=0.01)


def test_what_is_unknown_is_no_change() -> None:
    rng = np.random.default_rng(6)
    before = surface(rng)
    after = measured(before, rng)
    after[HOUSE] = np.nan
    found = compared(before, after)
    assert found.areas.max() == 0 and np.isnan(found.difference[HOUSE]).all()
    nothing = compared(before, np.full_like(before, np.nan))
    assert np.isnan(nothing.limit_m) and not nothing.areas.any()


def test_an_area_is_written_once_with_what_changed_in_it() -> None:
    areas = np.zeros((40, 50), np.int32)
    areas[10:14, 10:20] = 1
    areas[14:18, 20:30] = 1  # joined at a corner
    difference = np.where(areas > 0, -1.5, 0.0).astype(np.float32)
    content = _geojson(HeightChanges(difference, areas, 0.3, 0.5), Affine(0.5, 0, 5e5, 0, -0.5, 5.3e6), "EPSG:32632")
    (feature,) = content["features"]
    assert feature["properties"] == {
        **{"kind": "lower", "area_m2": 80 * 0.25, "mean_change_m": -1.5, "largest_change_m": -1.5},
        "volume_m3": 80 * 0.25 * -1.5,
    }
    lon, lat = feature["geometry"]["coordinates"][0][0]
    assert 8.9 < lon < 9.1 and 47.8 < lat < 47.9


def test_the_picture_has_a_scale_and_north() -> None:
    found = HeightChanges(np.zeros((400, 400), np.float32), np.zeros((400, 400), np.int32), 0.3, 0.5)
    without, narrow, wide = difference_figure(found.difference), _figure(found, 0.25), _figure(found, 0.5)
    assert (narrow[300:, :200] != without[300:, :200]).any()  # the bar, whose words follow the size of a pixel
    assert (narrow[:100, 300:] != without[:100, 300:]).any()  # the arrow
    assert (narrow != wide).any()
