# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the self-calibrated focal length, and its correction by another source.

A block of photos from one height over nearly flat ground fits as well with a longer focal length from higher up. The
formal covariance of the bundle adjustment does not show it, because residuals are not independent: so the focal length
is also fixed at other values while everything else is adjusted, and the cost shows which of them fit about as well
(a profile likelihood). Measured in docs/decisions/0004.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from skymoor.engines.colmap import colmap_from_component, component_from_colmap
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.reconstruct.uncertainty import centre_covariances
from skymoor.types import Calibration, Component

PROFILE_RATIOS = (0.7, 0.85, 0.95, 0.99, 1.01, 1.05, 1.18, 1.4)
AS_GOOD = 0.1
"""Relative growth of the squared residuals below which two calibrations fit the photos about as well. It is far above
that of independent noise, because camera models have systematic errors: on real nadir blocks the focal length was
off by 4 and 20 percent where the cost had grown by 8 and 5 percent."""
TRACKS, TRACKS_PER_PHOTO = 2500, 25  # the longest, of which the calibration is profiled
UNCERTAIN_RATIO = 0.05
"""Heights scale with the focal length: with a wider interval, heights are not used."""


def adjust(
    reconstruction: pycolmap.Reconstruction,
    *,
    focal: bool = True,
    principal_point: bool = False,
    extra: bool = True,
    robust: bool = False,
    max_iterations: int = 50,
    fixed: Collection[int] = (),
) -> float:
    """Bundle adjustment in place; returns the root mean square reprojection error in pixels.

    `robust` reduces the weight of outliers (Cauchy's loss at one pixel); the intrinsics of cameras in `fixed`, by their
    ids, stay as they are.
    """
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=focal,
        refine_principal_point=principal_point,
        refine_extra_params=extra,
        print_summary=False,
    )
    # Several threads sum in any order: results would differ in the last digits from run to run.
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = max_iterations
    options.ceres.solver_options.function_tolerance = 1e-6
    if robust:
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    config = _all_images(reconstruction)
    for camera_id in fixed:
        config.set_constant_cam_intrinsics(camera_id)
    # The adjuster itself, not pycolmap.bundle_adjustment, which writes to stderr at any log level.
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    reconstruction.update_point_3d_errors()
    return rms_px(reconstruction)


def rms_px(reconstruction: pycolmap.Reconstruction) -> float:
    """Root mean square reprojection error over all observations, in pixels."""
    points = reconstruction.points3D.values()
    squared = sum(p.error**2 * p.track.length() for p in points)
    return float(np.sqrt(squared / max(1, sum(p.track.length() for p in points))))


def calibrate(reconstruction: pycolmap.Reconstruction, *, ratios: Sequence[float] = PROFILE_RATIOS) -> Calibration:
    """Profile the focal length of a finished reconstruction, which is not changed."""
    cameras = {reconstruction.image(i).camera_id for i in reconstruction.reg_image_ids()}
    focal_px = float(np.median([reconstruction.camera(c).mean_focal_length() for c in cameras]))
    base = thin(reconstruction)
    rms = adjust(base)
    excess = {1.0: 0.0}
    for ratio in ratios:
        trial = pycolmap.Reconstruction(base)
        scale_focal(trial, ratio)
        excess[ratio] = (adjust(trial, focal=False) / rms) ** 2 - 1
    good = [ratio for ratio, value in excess.items() if value < AS_GOOD]
    low, high = _crossing(excess, min(good), -1), _crossing(excess, max(good), +1)
    return Calibration(
        shared_intrinsics=len(cameras) == 1,
        focal_px=focal_px,
        focal_sigma_ratio=focal_sigma(base),
        focal_low_ratio=low,
        focal_high_ratio=high,
        uncertain=high - low > UNCERTAIN_RATIO,
    )


def widened(calibration: Calibration, sigma: float) -> Calibration:
    """With a further relative standard deviation of the focal length, of some of the cameras."""
    half = LE90_PER_SIGMA * sigma
    low = 1 - float(np.hypot(1 - calibration.focal_low_ratio, half))
    high = 1 + float(np.hypot(calibration.focal_high_ratio - 1, half))
    return replace(calibration, focal_low_ratio=low, focal_high_ratio=high, uncertain=high - low > UNCERTAIN_RATIO)


def _crossing(excess: dict[float, float], edge: float, direction: int) -> float:
    """The ratio beyond the last good one at which the cost reaches `AS_GOOD`, by quadratic interpolation."""
    beyond = sorted((r for r in excess if (r - edge) * direction > 0), key=lambda r: abs(r - edge))
    if not beyond:
        return edge
    low, high = max(excess[edge], 0.0) ** 0.5, excess[beyond[0]] ** 0.5
    share = (AS_GOOD**0.5 - low) / (high - low)
    return edge + (beyond[0] - edge) * float(np.clip(share, 0, 1))


def scale_focal(reconstruction: pycolmap.Reconstruction, ratio: float) -> None:
    """Multiply the focal lengths; a following adjustment adapts the rest."""
    for camera in reconstruction.cameras.values():
        for index in camera.focal_length_idxs():
            params = camera.params
            params[index] *= ratio
            camera.params = params


def thin(reconstruction: pycolmap.Reconstruction, max_points: int | None = None) -> pycolmap.Reconstruction:
    """A copy with only the longest tracks: enough for the calibration, several times faster.

    Without a number, `TRACKS` of them, or `TRACKS_PER_PHOTO` for each photo where that is more: of a large block, 2500
    would leave photos with a point or none, and no covariance.
    """
    if max_points is None:
        max_points = max(TRACKS, TRACKS_PER_PHOTO * reconstruction.num_reg_images())
    copy = pycolmap.Reconstruction(reconstruction)
    lengths = {k: p.track.length() for k, p in copy.points3D.items()}
    for k in sorted(lengths, key=lambda k: -lengths[k])[max_points:]:
        copy.delete_point3D(k)
    return copy


def focal_sigma(reconstruction: pycolmap.Reconstruction) -> float:
    """Relative standard deviation of the focal length by the formal covariance (optimistic), NaN where unknown."""
    sigmas = list(focal_sigmas(reconstruction).values())
    return float(np.median(sigmas)) if sigmas else float("nan")


def focal_sigmas(reconstruction: pycolmap.Reconstruction) -> dict[int, float]:
    """The same for each camera, by its id; without cameras of unknown covariance."""
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.ceres.solver_options.num_threads = 1
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, _all_images(reconstruction), reconstruction)
    requested = pycolmap.BACovarianceOptions(params=pycolmap.BACovarianceOptionsParams.ALL)
    covariance = pycolmap.estimate_ba_covariance(requested, reconstruction, adjuster)
    if covariance is None:
        return {}
    noise_px, sigmas = rms_px(reconstruction), {}
    for camera_id, camera in reconstruction.cameras.items():
        block = covariance.get_other_params_cov(camera.params)
        if block is not None:
            sigmas[camera_id] = float(np.sqrt(block[0, 0])) / camera.mean_focal_length() * noise_px
    return sigmas


def _all_images(reconstruction: pycolmap.Reconstruction) -> pycolmap.BundleAdjustmentConfig:
    """All images are adjusted; two cameras fix the frame."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return config


def with_focal(component: Component, ratio: float, sigma: float) -> Component:
    """The component adjusted again with its focal lengths fixed at `ratio` times their present value.

    `sigma` is their relative standard deviation afterwards. Names, point order and colours are kept; the frame changes
    with the adjustment, so the result must be levelled again.
    """
    reconstruction = colmap_from_component(component)
    scale_focal(reconstruction, ratio)
    adjust(reconstruction, focal=False)
    same_names = {camera.image: camera.image for camera in component.cameras}
    calibration = component.calibration
    if calibration is not None:
        known = calibration.narrowed(1.0, sigma)
        calibration = replace(known, focal_px=calibration.focal_px * ratio, relief_ratio=ratio)
    adjusted = component_from_colmap(reconstruction, same_names)
    covariances = centre_covariances(reconstruction, adjusted)
    return replace(adjusted, colours=component.colours, calibration=calibration, centre_covariances=covariances)
