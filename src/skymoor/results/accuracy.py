# SPDX-License-Identifier: Apache-2.0
"""Predicted accuracy of a registered component: of its cameras and of its surface."""

from __future__ import annotations

from typing import Any

import numpy as np

from skymoor.geo import ce90_m, le90_m
from skymoor.pipeline.job import ComponentResult
from skymoor.registration import CameraAccuracy, camera_accuracy
from skymoor.types import Array, Reference

SURFACE_POINTS = 200  # at which the accuracy of a surface is told
MATCH_SIGMA_PX, SURFACE_SIGMA_UP_M = 0.15, 0.1
"""Errors that all matches share and their residuals do not show: of each horizontal axis in pixels of the reference,
and of heights. Thousands of matches average to millimetres, and yet the surfaces of three simulated sites and a real
one were 0.06 to 0.09 m aside, which is 0.15 to 0.2 pixels, and 0.06 to 0.12 m too low. Not proven on others."""


def accuracy_of(item: ComponentResult, reference: Reference) -> CameraAccuracy:
    """Covariances of the camera centres of a registered component, or without cameras of points on its surface.

    A ground component is registered to an airborne one, and inherits its covariance at the position of its cameras.
    """
    base, shape = item.base, item.shape_enu
    centres = np.array([camera.centre for camera in item.cameras_enu]).reshape(-1, 3)
    if not item.component.cameras:
        return _of_surface(item, reference)
    if item.scaled_by_focal_length:
        viewed = item.viewed_enu if item.registration.registered else None
        return camera_accuracy(item.registration, centres, reference, item.component.calibration, shape, viewed)
    found = camera_accuracy(item.registration, centres, reference, None, shape)
    if base is None:
        return found
    carried = camera_accuracy(base.registration, centres, reference, base.component.calibration)
    return CameraAccuracy(carried.shared, found.relative + carried.relative)


def _of_surface(item: ComponentResult, reference: Reference) -> CameraAccuracy:
    """Of points on the surface, with what all matches share, where control has not replaced them."""
    found = camera_accuracy(item.registration, _surface_points(item), reference, None)
    if item.registration.absolute is not None:
        return found
    pixel_m = reference.finest_m if reference.detail_lost else reference.grid.pixel_m
    shared = np.diag([MATCH_SIGMA_PX * pixel_m] * 2 + [SURFACE_SIGMA_UP_M]) ** 2
    return CameraAccuracy(found.shared, found.relative + shared)


def _surface_points(item: ComponentResult) -> Array:
    """Points (n, 3) of a registered model without cameras, ENU: its accuracy is told at these."""
    points, transform = item.component.points, item.registration.enu_from_level
    step = max(1, len(points) // SURFACE_POINTS)
    return np.zeros((0, 3)) if transform is None else transform.apply(points[::step])


def figures_of(accuracy: CameraAccuracy) -> Array:
    """CE90 and LE90 of each camera, and both without the reference's error, (n, 4) metres."""
    rows = [
        [ce90_m(total), le90_m(total), ce90_m(relative), le90_m(relative)]
        for total, relative in zip(accuracy.total, accuracy.relative, strict=True)
    ]
    return np.array(rows).reshape(-1, 4)


def surface_accuracy(item: ComponentResult, reference: Reference) -> dict[str, Any] | None:
    """Accuracy of a component's surface, each with and without the reference's error.

    Covariances (3, 3) are means over its points, m^2 east-north-up; CE90 and LE90 are those of them, metres. What is
    absolute is NaN where the accuracy of the reference is unknown. `similarity_covariance` (7, 7) is that of the
    logarithm of the scale, the rotation vector and the shift at `centroid_enu`. None for ground components, whose
    accuracy is that of the airborne one and their own.
    """
    found = item.registration
    if item.base is not None or found.covariance is None or not len(item.component.points):
        return None
    points = _of_surface(item, reference)
    mean = CameraAccuracy(*(part.mean(axis=0, keepdims=True) for part in (points.shared, points.relative)))
    names = ("ce90_m", "le90_m", "relative_ce90_m", "relative_le90_m")
    known = reference.accuracy_known or found.absolute is not None
    covariances = {
        "covariance_m2": mean.total[0] if known else None,
        "relative_covariance_m2": mean.relative[0],
        "similarity_covariance": found.covariance if found.absolute is None else found.absolute[:7, :7],
        "centroid_enu": found.centroid_enu,
    }
    return covariances | dict(zip(names, figures_of(mean)[0].tolist(), strict=True))
