# SPDX-License-Identifier: Apache-2.0
"""Calibrations: standard deviations against the scatter of repeated adjustments, and residuals over the image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skymoor.engines.colmap import colmap_from_component, component_from_colmap
from skymoor.reconstruct import calibration
from skymoor.reconstruct.calibration import adjust
from skymoor.results.lenses import FIELD_COLUMNS, FIELD_ROWS, _as_adjusted, lens_figures, lens_residuals, residual_field
from skymoor.results.statistics import image_residuals
from skymoor.types import Calibration, Component
from support.blocks import LENS, block

NAMES = ("fx", "cx", "cy", "k1", "k2")


def figures(component: Component) -> dict[str, Any]:
    (found,) = lens_figures(component)
    return found


def adjusted(exact: Component, rng: np.random.Generator) -> Component:
    """The block with other errors of its pixels, adjusted as a run does it."""
    noisy = replace(exact, obs_px=exact.obs_px + rng.normal(0, 0.5, exact.obs_px.shape))
    reconstruction = colmap_from_component(noisy)
    for camera in reconstruction.cameras.values():
        _as_adjusted(camera, LENS)
    adjust(reconstruction, principal_point=True)
    return component_from_colmap(reconstruction, {camera.image: camera.image for camera in noisy.cameras})


def test_standard_deviations_are_the_scatter_of_repeated_adjustments() -> None:
    exact, rng = block("oblique", relief_m=8.0, noise_px=0.0, n=200), np.random.default_rng(0)
    found = [figures(adjusted(exact, rng)) for _ in range(12)]
    errors = np.array([[one[name] - true_value(name) for name in NAMES] for one in found])
    predicted = np.mean([[one["sigma"][name] for name in NAMES] for one in found], axis=0)
    ratio = np.sqrt((errors**2).mean(axis=0)) / predicted  # of 12 draws, within 0.6 and 1.45 in 95 % of cases
    assert (ratio > 0.5).all() and (ratio < 1.6).all(), ratio


def true_value(name: str) -> float:
    distortion = dict(zip(("k1", "k2", "p1", "p2"), LENS.distortion, strict=True))
    return distortion[name] if name in distortion else float(getattr(LENS, name))


def test_what_was_not_adjusted_has_no_standard_deviation() -> None:
    whole = block("oblique", relief_m=8.0, n=150)
    sigma = figures(whole)["sigma"]
    assert sigma["p1"] is None and sigma["p2"] is None and sigma["k2"] > 0
    centred = replace(LENS, cx=200.0, cy=150.0, distortion=(-0.05, 0.0, 0.0, 0.0))
    cameras = tuple(replace(camera, intrinsics=centred) for camera in whole.cameras)
    sigma = figures(replace(whole, cameras=cameras))["sigma"]
    assert [name for name, value in sigma.items() if value is None] == ["cx", "cy", "k2", "p1", "p2"]


def test_the_profile_of_the_focal_length_counts_more_than_the_formal_figure() -> None:
    calibration = Calibration(True, LENS.fx, 0.0, 0.98, 1.02, False)
    found = figures(replace(block("oblique", relief_m=8.0, n=150), calibration=calibration))
    assert found["sigma"]["fx"] == pytest.approx(calibration.focal_sigma * LENS.fx)
    assert found["sigma"]["fx"] == pytest.approx(0.02 / 1.645 * LENS.fx, rel=1e-3)


def test_each_lens_has_its_own_line() -> None:
    whole = block("oblique", relief_m=8.0, n=150)
    other = replace(LENS, fx=500.0, fy=500.0)
    cameras = tuple(replace(one, intrinsics=other) if k < 4 else one for k, one in enumerate(whole.cameras))
    mixed = replace(whole, cameras=cameras)
    found = lens_figures(mixed)
    assert [(one["fx"], one["n_photos"]) for one in found] == [(392.0, len(cameras) - 4), (500.0, 4)]
    fields = lens_residuals(mixed, image_residuals(mixed))
    assert len(fields) == 2
    worst = [max(np.hypot(*row[2:4]) for row in field) for field in fields]
    assert worst[0] < 1 < 5 < worst[1]  # the pixels of the other four were not made with that focal length


def test_residuals_over_the_image_are_means_of_cells() -> None:
    rng = np.random.default_rng(2)
    px = rng.uniform([0, 0], [LENS.width, LENS.height], (4000, 2))
    wanted = np.column_stack([0.002 * (px[:, 0] - 200), np.full(len(px), -0.3)])
    field = residual_field(LENS, px, wanted + rng.normal(0, 0.2, px.shape))
    vectors = np.array(field)
    assert len(vectors) == FIELD_COLUMNS * FIELD_ROWS and vectors[:, 4].sum() == len(px)
    np.testing.assert_allclose(vectors[:, 2], 0.002 * (vectors[:, 0] - 200), atol=0.12)
    np.testing.assert_allclose(vectors[:, 3], -0.3, atol=0.12)
    assert vectors[:, 2].min() < -0.2 and vectors[:, 2].max() > 0.2


def test_a_cell_of_few_observations_is_left_out() -> None:
    px = np.vstack([np.full((4, 2), 5.0), np.full((5, 2), 290.0)])
    assert [row[4] for row in residual_field(LENS, px, np.ones((9, 2)))] == [5]
    assert residual_field(LENS, px, np.full((9, 2), np.nan)) == []


def test_many_photos_keep_enough_tracks_for_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """The longest tracks are in the middle of a block: of too few, photos at its edge would have none."""
    whole = block("nadir", relief_m=8.0, n=1500)
    everything = figures(whole)["sigma"]["k1"]
    monkeypatch.setattr(calibration, "TRACKS", 8)
    enough = figures(whole)["sigma"]["k1"]
    monkeypatch.setattr(calibration, "TRACKS_PER_PHOTO", 0)
    few = figures(whole)["sigma"]["k1"]
    assert everything <= enough < 4 * everything and (few is None or few > 10 * everything)
