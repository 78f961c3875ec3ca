# SPDX-License-Identifier: Apache-2.0
"""The calibration report states the uncertainty that the photos leave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.engines.colmap import colmap_from_component
from skymoor.geometry import umeyama
from skymoor.reconstruct import with_focal
from skymoor.reconstruct.calibration import PROFILE_RATIOS, adjust, calibrate, rms_px, scale_focal, thin
from skymoor.types import Calibration, Component
from support.blocks import LENS, block

Array = NDArray[np.float64]


def calibrated(component: Component, *, wrong_focal: float) -> Calibration:
    """Begin with a wrong focal length, adjust, and report."""
    reconstruction = colmap_from_component(component)
    scale_focal(reconstruction, wrong_focal)
    adjust(reconstruction)
    return calibrate(reconstruction)


def contains_truth(calibration: Calibration) -> bool:
    ratio = LENS.fx / calibration.focal_px
    return calibration.focal_low_ratio <= ratio <= calibration.focal_high_ratio


@pytest.mark.parametrize("wrong_focal", [0.95, 1.05])
def test_an_oblique_ring_fixes_the_focal_length(wrong_focal: float) -> None:
    calibration = calibrated(block("oblique", relief_m=3.0), wrong_focal=wrong_focal)
    assert not calibration.uncertain
    assert calibration.shared_intrinsics
    assert calibration.focal_px == pytest.approx(LENS.fx, rel=0.003)
    assert contains_truth(calibration)
    assert 0.002 < calibration.focal_sigma < 0.025
    assert 0.00005 < calibration.focal_sigma_ratio < 0.005


@pytest.mark.parametrize("relief_m", [0.0, 1.0, 6.0])
def test_a_block_from_one_height_over_flat_ground_does_not(relief_m: float) -> None:
    calibration = calibrated(block("nadir", relief_m=relief_m), wrong_focal=1.05)
    assert calibration.uncertain
    assert calibration.focal_high_ratio - calibration.focal_low_ratio > 0.2
    # Where nothing at all is known the interval ends with what was tried.
    everything = (calibration.focal_low_ratio, calibration.focal_high_ratio) == (PROFILE_RATIOS[0], PROFILE_RATIOS[-1])
    assert everything or contains_truth(calibration)


def test_relief_narrows_the_interval() -> None:
    flat, hilly = (calibrated(block("nadir", relief_m=r), wrong_focal=1.0) for r in (1.0, 40.0))
    width = [c.focal_high_ratio - c.focal_low_ratio for c in (flat, hilly)]
    assert width[1] < 0.9 * width[0]
    assert contains_truth(hilly)


def test_calibrate_leaves_the_reconstruction_alone() -> None:
    reconstruction = colmap_from_component(block("oblique", relief_m=3.0))
    adjust(reconstruction)
    before = reconstruction.point3D(7).xyz.copy(), rms_px(reconstruction)
    calibrate(reconstruction)
    np.testing.assert_array_equal(reconstruction.point3D(7).xyz, before[0])
    assert rms_px(reconstruction) == before[1]
    assert reconstruction.num_points3D() == 600


def test_reprojection_error_is_the_noise() -> None:
    reconstruction = colmap_from_component(block("oblique", relief_m=3.0, noise_px=0.4))
    adjusted = adjust(reconstruction)
    # Both coordinates together, less what the adjustment absorbs; a track's mean error is below its rms.
    assert 0.75 * 0.4 * np.sqrt(2) < adjusted < 0.4 * np.sqrt(2)


def test_large_adjustments_repeat_to_the_last_digit() -> None:
    """COLMAP lets threads race above 50 000 residuals."""
    component = block("oblique", relief_m=3.0, n=3000)
    assert 2 * len(component.obs_px) > 50_000
    results = []
    for _ in range(4):
        reconstruction = colmap_from_component(component)
        scale_focal(reconstruction, 1.02)
        adjust(reconstruction)
        results.append(np.array([reconstruction.point3D(k).xyz for k in sorted(reconstruction.point3D_ids())]))
    assert all((result == results[0]).all() for result in results)


def test_thinning_keeps_the_longest_tracks() -> None:
    reconstruction = colmap_from_component(block("oblique", relief_m=3.0))
    lengths = sorted((p.track.length() for p in reconstruction.points3D.values()), reverse=True)
    few = thin(reconstruction, max_points=100)
    assert sorted((p.track.length() for p in few.points3D.values()), reverse=True) == lengths[:100]
    assert reconstruction.num_points3D() == 600


class TestWithFocal:
    @pytest.mark.parametrize("ratio", [0.85, 1.2])
    def test_heights_of_a_flat_block_stretch_with_the_focal_length(self, ratio: float) -> None:
        component = block("nadir", relief_m=4.0, noise_px=0.05)
        known = Calibration(True, LENS.fx, 0.001, 0.8, 1.3, True)
        changed = with_focal(replace(component, calibration=known), ratio, 0.03)
        assert [c.image for c in changed.cameras] == [c.image for c in component.cameras]
        np.testing.assert_array_equal(changed.colours, component.colours)
        for camera in changed.cameras:
            assert camera.intrinsics.fx == pytest.approx(LENS.fx * ratio, rel=1e-9)
        # Flying heights follow exactly, relief somewhat less: the cameras' tilts take up a part of the change.
        relief, flying = stretch(component, changed)
        assert flying == pytest.approx(ratio, rel=0.01)
        assert 0.5 < np.log(relief) / np.log(ratio) < 1.1
        assert changed.reprojection_px < 0.3
        assert changed.calibration is not None
        assert changed.calibration.focal_px == pytest.approx(LENS.fx * ratio)
        assert changed.calibration.focal_sigma == pytest.approx(0.03)

    def test_the_same_focal_length_changes_nothing(self) -> None:
        component = block("oblique", relief_m=4.0, noise_px=0.05)
        same = with_focal(component, 1.0, 0.01)
        back = umeyama(same.points, component.points)
        assert np.abs(back.apply(same.points) - component.points).max() < 0.15
        assert np.abs(back.apply(same.centres) - component.centres).max() < 0.05
        assert same.calibration is None

    def test_an_oblique_block_resists(self) -> None:
        component = block("oblique", relief_m=4.0, noise_px=0.05)
        assert with_focal(component, 1.1, 0.01).reprojection_px > 8 * 0.05


def stretch(before: Component, after: Component) -> tuple[float, float]:
    """By how much relief and flying height have grown against plan, by an affine fit to the points."""
    design = np.column_stack([before.points, np.ones(len(before.points))])
    affine = np.linalg.lstsq(design, after.points, rcond=None)[0][:3].T
    normal = np.cross(affine[:, 0], affine[:, 1])
    horizontal = np.sqrt(np.linalg.norm(normal))
    up = normal / np.linalg.norm(normal)
    flying = [(c.centres.mean(axis=0) - c.points.mean(axis=0)) @ axis for c, axis in ((after, up), (before, [0, 0, 1]))]
    return float(np.linalg.norm(affine[:, 2]) / horizontal), float(flying[0] / horizontal / flying[1])
