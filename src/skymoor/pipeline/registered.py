# SPDX-License-Identifier: Apache-2.0
"""What a registration says beforehand of a component, as control takes it: its cameras, and the covariances of all."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from skymoor.control import PosedCameras, Prior
from skymoor.pipeline.job import ComponentResult
from skymoor.registration import SHAPE_FACTOR, camera_accuracy, focal_motion
from skymoor.types import Calibration, Reference


def prior_of(item: ComponentResult, reference: Reference) -> Prior:
    """What a registration says beforehand of a correction by control: its covariance with the reference's own.

    That of the airborne model below a ground component is taken at the middle of the latter.
    """
    found, base = item.registration, item.base
    assert found.covariance is not None and found.centroid_enu is not None
    calibration = _calibration(item)
    covariance = block_diag(found.covariance, 0.0 if calibration is None else calibration.focal_sigma**2)
    shared = np.nan_to_num(reference.covariance)
    if base is not None:
        carried = camera_accuracy(base.registration, found.centroid_enu, reference, base.component.calibration)
        shared = carried.relative[0] + np.nan_to_num(carried.shared[0])
    covariance[4:7, 4:7] += shared
    known = reference.accuracy_known or (base is not None and base.registration.absolute is not None)
    heights_known = item.heights is None or item.heights.status != "NOT_CONFIRMED"
    return Prior(covariance, found.centroid_enu, known, heights_known)


def posed_cameras(item: ComponentResult) -> PosedCameras:
    """The cameras of a registered component, and their errors within it."""
    assert item.registration.centroid_enu is not None
    calibration, shape = _calibration(item), item.shape_enu
    centres = np.array([camera.centre for camera in item.cameras_enu]).reshape(-1, 3)
    viewed = item.viewed_enu if calibration is not None else None
    away = focal_motion(centres, item.registration.centroid_enu, calibration, viewed)
    return PosedCameras(tuple(item.cameras_enu), None if shape is None else SHAPE_FACTOR**2 * shape, away)


def _calibration(item: ComponentResult) -> Calibration | None:
    return item.component.calibration if item.scaled_by_focal_length else None
