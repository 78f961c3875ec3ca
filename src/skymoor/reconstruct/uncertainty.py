# SPDX-License-Identifier: Apache-2.0
"""Formal covariances of camera centres from bundle adjustment, free of the datum.

An adjustment from pixels alone has a datum defect of seven, and a covariance depends on how the datum is fixed. Here it
is fixed by all camera centres together (inner constraints: Baarda's S-transformation), so that the covariance is that
of the shape, without the part that a similarity can correct.
"""

from __future__ import annotations

import numpy as np
import pycolmap

from skymoor.types import Array, Component

MAX_CAMERAS = 400  # beyond, the covariance of all poses grows to gigabytes
UNKNOWNS = {"pose": 6, "point": 3, "gauge": 7}


def centre_covariances(reconstruction: pycolmap.Reconstruction, component: Component) -> Array | None:
    """Covariances (n, 3, 3) of the camera centres of a reconstruction, in its unit squared, in the component's order.

    `component` is the same reconstruction, as `component_from_colmap` returns it.

    They are formal: for independent pixel errors of the size of the residuals. None where the adjustment gives no
    covariance, or for more than `MAX_CAMERAS` cameras.
    """
    ids = sorted(reconstruction.reg_image_ids())
    if not 3 <= len(ids) <= MAX_CAMERAS:
        return None
    poses = _pose_covariance(reconstruction, ids)
    if poses is None:
        return None
    jacobian = np.zeros((3 * len(ids), 6 * len(ids)))
    for k, image_id in enumerate(ids):
        pose = reconstruction.image(image_id).cam_from_world()
        rotation, translation = pose.rotation.matrix(), np.array(pose.translation)
        # The tangent is that of a quaternion from the left: half of the angle.
        block = np.hstack([-2 * rotation.T @ _cross(translation), -rotation.T])
        jacobian[3 * k : 3 * k + 3, 6 * k : 6 * k + 6] = block
    centres = np.array([reconstruction.image(i).projection_center() for i in ids])
    projector = _without_gauge(centres)
    projected = projector @ jacobian
    whole = _pixel_variance(component) * projected @ poses @ projected.T
    return np.array([whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(ids))])


def _pose_covariance(reconstruction: pycolmap.Reconstruction, ids: list[int]) -> Array | None:
    """Of the tangents (6 n, 6 n) of all poses, for pixels of variance 1, with three points fixed."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in ids:
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.THREE_POINTS)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    requested = pycolmap.BACovarianceOptions(params=pycolmap.BACovarianceOptionsParams.POSES)
    covariance = pycolmap.estimate_ba_covariance(requested, reconstruction, adjuster)
    if covariance is None:
        return None
    whole = np.zeros((6 * len(ids), 6 * len(ids)))
    for a, i in enumerate(ids):
        for b, j in enumerate(ids[: a + 1]):
            block = covariance.get_cam_cov_from_world(i) if i == j else covariance.get_cam_cross_cov_from_world(i, j)
            if block is None or block.shape != (6, 6):
                return None
            whole[6 * a : 6 * a + 6, 6 * b : 6 * b + 6] = block
            whole[6 * b : 6 * b + 6, 6 * a : 6 * a + 6] = block.T
    return whole if np.isfinite(whole).all() else None


def _pixel_variance(component: Component) -> float:
    """A-posteriori variance of an image coordinate: squared residuals over the redundancy."""
    squares = 0.0
    for k, camera in enumerate(component.cameras):
        own = component.obs_camera == k
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[own]])
        squares += float(np.nansum((camera.intrinsics.px_from_cam(xyz_cam) - component.obs_px[own]) ** 2))
    unknowns = UNKNOWNS["pose"] * len(component.cameras) + UNKNOWNS["point"] * len(component.points)
    return squares / max(component.obs_px.size - unknowns + UNKNOWNS["gauge"], 1)


def _without_gauge(centres: Array) -> Array:
    """Projector (3 n, 3 n) of displacements of the centres onto those that no similarity produces."""
    from_middle = centres - centres.mean(axis=0)
    gauge = np.zeros((len(centres), 3, 7))
    gauge[:, :, 0] = from_middle
    gauge[:, :, 1:4] = [-_cross(point) for point in from_middle]
    gauge[:, :, 4:] = np.eye(3)
    # With collinear cameras, the rotation about their line displaces none of them.
    basis, strength, _ = np.linalg.svd(gauge.reshape(-1, 7), full_matrices=False)
    similarities = basis[:, strength > 1e-9 * strength[0]]
    return np.asarray(np.eye(len(basis)) - similarities @ similarities.T)


def _cross(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
