# SPDX-License-Identifier: Apache-2.0
"""How well a bundle adjustment knows its own shape: covariances of camera centres, whatever the frame.

An adjustment from pixels alone leaves seven numbers open, and a covariance depends on how they are held. Here they are
held by all camera centres together (inner constraints: Baarda's S-transformation), so that what is left is what no
similarity can mend.
"""

from __future__ import annotations

import numpy as np
import pycolmap

from skymoor.types import Array, Component

MAX_CAMERAS = 400  # beyond, the covariance of all poses grows to gigabytes
UNKNOWNS = {"pose": 6, "point": 3, "gauge": 7}


def centre_covariances(reconstruction: pycolmap.Reconstruction, component: Component) -> Array | None:
    """Covariances (n, 3, 3) of the camera centres of a reconstruction, in its unit squared, in the component's order.

    `component` is the same reconstruction, as `component_from_colmap` says it.

    They are formal: of pixel errors that are independent and as large as the residuals. None where the adjustment
    cannot say it, or has more cameras than fit into memory.
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
    free = _without_gauge(centres)
    half = free @ jacobian
    whole = _pixel_variance(component) * half @ poses @ half.T
    return np.array([whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(ids))])


def _pose_covariance(reconstruction: pycolmap.Reconstruction, ids: list[int]) -> Array | None:
    """Of the tangents (6 n, 6 n) of all poses, for pixels of variance 1, with three points held."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in ids:
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.THREE_POINTS)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    wanted = pycolmap.BACovarianceOptions(params=pycolmap.BACovarianceOptionsParams.POSES)
    found = pycolmap.estimate_ba_covariance(wanted, reconstruction, adjuster)
    if found is None:
        return None
    whole = np.zeros((6 * len(ids), 6 * len(ids)))
    for a, i in enumerate(ids):
        for b, j in enumerate(ids[: a + 1]):
            block = found.get_cam_cov_from_world(i) if i == j else found.get_cam_cross_cov_from_world(i, j)
            if block is None or block.shape != (6, 6):
                return None
            whole[6 * a : 6 * a + 6, 6 * b : 6 * b + 6] = block
            whole[6 * b : 6 * b + 6, 6 * a : 6 * a + 6] = block.T
    return whole if np.isfinite(whole).all() else None


def _pixel_variance(component: Component) -> float:
    """Of one coordinate of an observation, by the residuals and what the unknowns have taken from them."""
    squares = 0.0
    for k, camera in enumerate(component.cameras):
        mine = component.obs_camera == k
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[mine]])
        squares += float(np.nansum((camera.intrinsics.px_from_cam(xyz_cam) - component.obs_px[mine]) ** 2))
    unknowns = UNKNOWNS["pose"] * len(component.cameras) + UNKNOWNS["point"] * len(component.points)
    return squares / max(component.obs_px.size - unknowns + UNKNOWNS["gauge"], 1)


def _without_gauge(centres: Array) -> Array:
    """What is left (3 n, 3 n) of moves of the centres after the best similarity has followed them."""
    from_middle = centres - centres.mean(axis=0)
    gauge = np.zeros((len(centres), 3, 7))
    gauge[:, :, 0] = from_middle
    gauge[:, :, 1:4] = [-_cross(point) for point in from_middle]
    gauge[:, :, 4:] = np.eye(3)
    # Cameras on a line leave a turn about it open, which moves none of them.
    basis, strength, _ = np.linalg.svd(gauge.reshape(-1, 7), full_matrices=False)
    held = basis[:, strength > 1e-9 * strength[0]]
    return np.asarray(np.eye(len(basis)) - held @ held.T)


def _cross(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
