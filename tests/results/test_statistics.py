# SPDX-License-Identifier: Apache-2.0
"""Figures of a reconstruction, on blocks whose answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.pipeline.job import ComponentResult
from skymoor.results.statistics import (
    component_details,
    component_statistics,
    covered_m2,
    ellipses_of,
    error_ellipse,
    image_residuals,
    overlap,
    photo_figures,
    reprojection_errors,
    shared_points,
)
from skymoor.types import Array, Component, Registration
from support.blocks import LENS, block, ground_points, observed, strips

NOISE_PX, HEIGHT_M = 0.4, 60.0


def placed(component: Component, scale: float = 1.0) -> ComponentResult:
    enu_from_level = Similarity(scale, np.eye(3), np.zeros(3))
    return ComponentResult("airborne-0", component, Similarity.identity(), Registration(True, "", enu_from_level))


def test_residuals_are_the_noise_that_was_put_in() -> None:
    noisy = block("nadir", relief_m=4.0, noise_px=NOISE_PX)
    errors = reprojection_errors(noisy)
    # The mean length of a normal vector in the plane is sqrt(pi / 2) sigma, its root mean square sqrt(2) sigma.
    assert errors.mean() == pytest.approx(NOISE_PX * np.sqrt(np.pi / 2), rel=0.05)
    found = component_statistics(placed(noisy))
    assert found["mean_reprojection_px"] == pytest.approx(errors.mean())
    assert found["rms_reprojection_px"] == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.05)


def test_residuals_are_observed_minus_projected() -> None:
    exact = block("nadir", relief_m=4.0, noise_px=0.0)
    moved = replace(exact, obs_px=exact.obs_px + [0.5, -0.25])
    np.testing.assert_allclose(image_residuals(moved), np.tile([0.5, -0.25], (len(exact.obs_px), 1)), atol=1e-6)


def test_tie_points_and_tracks_are_counted() -> None:
    component = block("nadir", relief_m=4.0)
    alone = np.vstack([component.points, [[0.0, 0.0, 0.0]]])  # a point that nothing sees is no tie point
    colours = np.vstack([component.colours, [[0, 0, 0]]]).astype(np.uint8)
    found = component_statistics(placed(replace(component, points=alone, colours=colours)))
    lengths = np.bincount(component.obs_point)
    assert found["n_tie_points"] == (lengths > 0).sum() == len(component.points)
    assert found["n_observations"] == lengths.sum()
    assert found["mean_track_length"] == pytest.approx(lengths.mean())


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_a_pixel_on_the_ground_is_height_over_focal_length(scale: float) -> None:
    component = block("nadir", relief_m=0.0)
    wanted = scale * HEIGHT_M / LENS.fx
    photos = photo_figures(component, scale)
    assert [one["gsd_m"] for one in photos] == pytest.approx([wanted] * len(photos), rel=0.03)
    assert component_statistics(placed(component, scale))["gsd_m"] == pytest.approx(wanted, rel=0.02)
    assert photo_figures(component, None)[0]["gsd_m"] is None
    assert sum(one["n_points"] for one in photos) == len(component.obs_px)


def test_pairs_share_the_points_that_both_see() -> None:
    component = block("nadir", relief_m=4.0)
    seen = [set(component.obs_point[component.obs_camera == k]) for k in range(len(component.cameras))]
    pairs = shared_points(component, strongest=100)
    assert {(a, b): n for a, b, n in pairs} == {
        (a, b): len(seen[a] & seen[b]) for a in range(len(seen)) for b in range(a + 1, len(seen)) if seen[a] & seen[b]
    }
    few = shared_points(component, strongest=1)
    assert len(component.cameras) / 2 <= len(few) <= len(component.cameras)
    for k in range(len(component.cameras)):
        best = max(n for a, b, n in pairs if k in (a, b))
        assert best in [n for a, b, n in few if k in (a, b)]


def _footprint(component: Component, plan: Array) -> Array:
    """How many photos show places of a plane at zero, from the definition."""
    xyz = np.column_stack([plan, np.zeros(len(plan))])
    inside = []
    for camera in component.cameras:
        px = camera.intrinsics.px_from_cam(camera.cam_from_world.apply(xyz))
        inside.append(((px >= 0) & (px <= [LENS.width, LENS.height])).all(axis=1))
    return np.sum(inside, axis=0)


def test_overlap_counts_the_photos_of_a_place() -> None:
    component = observed(strips(tilt_deg=0.0), ground_points(800, relief_m=0.0, extent_m=40.0))
    grid, counts = overlap(component)
    np.testing.assert_array_equal(counts.ravel(), _footprint(component, grid.centres().reshape(-1, 2)))
    assert counts.max() > 4
    dense = np.random.default_rng(0).uniform(-40, 40, (40000, 2))
    wanted = (_footprint(component, dense) >= 2).mean() * 80.0**2
    assert 0.9 * wanted < covered_m2(grid, counts) < 1.02 * wanted  # the outer percent of tie points is left out


def test_overlap_is_not_told_without_a_place_or_of_walls() -> None:
    component = block("nadir", relief_m=4.0)
    item = placed(component)
    assert component_statistics(item)["area_m2"] > 0
    refused = replace(item, registration=Registration(False, "", None))
    for one in (refused, replace(item, base=item)):
        assert component_statistics(one)["area_m2"] is None
        assert component_details(one, {})["overlap"] is None
    assert component_statistics(refused)["gsd_m"] is None


def test_nothing_is_made_up_for_a_model_without_photos() -> None:
    empty = Component(
        (), np.zeros((5, 3)), np.zeros((5, 3), np.uint8), *(np.zeros(0, np.int32),) * 2, np.zeros((0, 2)), 0
    )
    found = component_statistics(placed(empty))
    assert found["n_tie_points"] == 0 and found["lenses"] == []
    assert all(found[name] is None for name in ("mean_track_length", "mean_reprojection_px", "gsd_m", "area_m2"))
    assert component_details(placed(empty), {}) == {
        "photos": [],
        "shared_points": [],
        "residuals": [],
        "overlap": None,
    }


@pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 90.0, 150.0])
def test_an_ellipse_holds_nine_of_ten_errors(azimuth_deg: float) -> None:
    angle = np.radians(azimuth_deg)
    along, across = np.array([np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
    covariance = 9.0 * np.outer(along, along) + 1.0 * np.outer(across, across)
    found = error_ellipse(covariance)
    assert found is not None
    major, minor, azimuth = found
    assert major == pytest.approx(3 * minor) and (azimuth - azimuth_deg + 90) % 180 == pytest.approx(90, abs=1e-6)
    errors = np.random.default_rng(1).multivariate_normal([0, 0], covariance, 20000)
    inside = (errors @ along / major) ** 2 + (errors @ across / minor) ** 2 <= 1
    assert inside.mean() == pytest.approx(0.9, abs=0.01)


def test_an_unknown_accuracy_has_no_ellipse() -> None:
    found = ellipses_of(["a"], np.full((1, 3, 3), np.nan), np.eye(3)[None])
    assert found["a"]["ellipse_90"] is None and found["a"]["relative_ellipse_90"][0] == pytest.approx(2.146, abs=1e-3)
