# SPDX-License-Identifier: Apache-2.0
"""Points of the model from their pixels in posed photos, with covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts load when they are first used

from skymoor.control.given import Mark
from skymoor.types import Array, Camera

MARK_SIGMA_PX = 1.0
"""Standard deviation of a pixel that a person measured, each axis."""
LARGEST_PX = 5.0
"""Root mean square of the residuals from which on the marks of a point contradict each other."""
SMALLEST_ANGLE_DEG = 1.0
"""Largest angle between the rays of a point below which its distance is not determined."""


@dataclass(frozen=True, eq=False)
class Triangulated:
    """A point (3,) in the frame of the cameras, with its covariance (3, 3), the number of photos, and rms in pixels.

    `reason` says why it is not used; position and covariance are NaN then.
    """

    xyz: Array
    covariance: Array
    n_photos: int
    rms_px: float = float("nan")
    reason: str = ""


def triangulate(marks: Sequence[Mark], cameras: Mapping[str, Camera]) -> Triangulated:
    """Least-squares intersection of the rays of one point (e.g. Förstner and Wrobel 2016, section 13.4).

    The covariance is that of pixels with a standard deviation of one, or of what the residuals show where that is more;
    poses and lenses count as known.

    Args:
        marks: of the point; of photos without a camera none counts.
        cameras: posed photos by name, all in one frame.
    """
    seen = [(mark, cameras[mark.image]) for mark in marks if mark.image in cameras]
    n = len(seen)
    if n < 2:
        return _unusable(n, "seen in one registered photo: not used" if n else "no registered photo shows it")
    pixels = np.array([[mark.u, mark.v] for mark, _ in seen])
    rays = np.array([_ray(camera, px) for (_, camera), px in zip(seen, pixels, strict=True)])
    centres = np.array([camera.centre for _, camera in seen])
    if np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))) < SMALLEST_ANGLE_DEG:
        return _unusable(n, f"its rays are within {SMALLEST_ANGLE_DEG:.0f} degree: not used")
    start, shown = _nearest(centres, rays), [camera for _, camera in seen]

    def residuals(xyz: Array) -> Array:
        found = np.vstack([camera.intrinsics.px_from_cam(camera.cam_from_world.apply(xyz[None])) for camera in shown])
        return np.asarray(np.nan_to_num(found - pixels, nan=1e4).ravel())

    fit = scipy.optimize.least_squares(residuals, start, x_scale=np.linalg.norm(centres - start, axis=1).min())
    square = float(fit.fun @ fit.fun)
    rms = float(np.sqrt(square / (2 * n)))
    if rms > LARGEST_PX:
        worst = seen[int(np.argmax(np.linalg.norm(fit.fun.reshape(-1, 2), axis=1)))][0]
        text = f"its pixels contradict each other by {rms:.0f} px, most in {worst.image} ({worst.where}): not used"
        return _unusable(n, text)
    variance = max(MARK_SIGMA_PX**2, square / (2 * n - 3))
    return Triangulated(fit.x, variance * np.linalg.inv(fit.jac.T @ fit.jac), n, rms)


def _unusable(n: int, reason: str) -> Triangulated:
    return Triangulated(np.full(3, np.nan), np.full((3, 3), np.nan), n, reason=reason)


def _ray(camera: Camera, px: Array) -> Array:
    """Unit direction (3,) of a pixel in the frame of the cameras."""
    ray = camera.intrinsics.rays(px)[0] @ camera.cam_from_world.rotation
    return np.asarray(ray / np.linalg.norm(ray))


def _nearest(centres: Array, rays: Array) -> Array:
    """The point (3,) nearest to all rays."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    return np.asarray(np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centres)))
