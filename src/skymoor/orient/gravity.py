# SPDX-License-Identifier: Apache-2.0
"""Gravity from geometry alone (paper, section 3.1, gravity vector estimation; Szeliski 2006 for the horizon).

Two observations are combined by their weights. The ground plane is limited by the slope of the terrain. The x-axes of
cameras that people and gimbals hold level are horizontal, so the direction perpendicular to all of them is up: accurate
to a fraction of a degree where azimuths differ, but undetermined where all photos have the same azimuth. Each gives a
3 x 3 information matrix for the up vector; the estimate is the eigenvector of the smallest eigenvalue of the sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Plane, Similarity, fit_plane_ransac
from skymoor.types import Array, Component, Gravity, Mask


@dataclass(frozen=True)
class OrientOptions:
    """Uncertainty of each observation.

    Attributes:
        terrain_slope_deg: expected slope of the ground over the site.
        roll_floor_deg: lower bound of the roll sigma of the cameras.
        common_roll_deg: all cameras may share a roll of this size; it cancels only where azimuths differ.
        plane_threshold_ratio: RANSAC threshold as a share of the median camera-to-point distance.
        portrait_deg: an x-axis further from the horizon than this belongs to a photo in portrait orientation.
        min_ground_points: with fewer labelled ground points, the labels are not used.
    """

    terrain_slope_deg: float = 2.0
    roll_floor_deg: float = 0.5
    common_roll_deg: float = 1.0
    plane_threshold_ratio: float = 0.02
    portrait_deg: float = 20.0
    min_ground_points: int = 20


def estimate_gravity(
    component: Component,
    options: OrientOptions | None = None,
    *,
    rng: np.random.Generator,
    ground: Mask | None = None,
) -> Gravity:
    """Estimate the up direction of a component.

    `ground` (n,) marks the ground points, see `ground_points`: the plane is fitted to those alone, if they are enough.
    Without it the plane with most points is assumed to be the ground, which fails near a facade.

    Raises:
        DegenerateGeometry: neither the points nor the cameras determine a plane.
    """
    options = options or OrientOptions()
    rays = component.points[component.obs_point] - component.centres[component.obs_camera]
    distance = float(np.median(np.linalg.norm(rays, axis=1)))
    method = "labelled ground"
    if ground is None or np.count_nonzero(ground) < options.min_ground_points:
        ground, method = np.ones(len(component.points), dtype=bool), "plane"
    flat, down = component.points[ground], rays[ground[component.obs_point]]
    plane = _ground_plane(flat, options.plane_threshold_ratio * distance, rng)
    normal = plane.normal * _sign(plane.normal, down)
    horizon, roll_deg = horizon_information(component, normal, options)
    slope = np.radians(options.terrain_slope_deg)
    level = (np.eye(3) - np.outer(normal, normal)) / slope**2
    values, vectors = np.linalg.eigh(horizon + level)
    up = vectors[:, 0] * np.sign(vectors[:, 0] @ normal)
    tangent_values, tangent = np.linalg.eigh(horizon)
    cameras_up = tangent[:, 0] * np.sign(tangent[:, 0] @ normal)
    determined = tangent_values[1] > 1 / slope**2
    near = np.abs(flat @ plane.normal - plane.offset) < options.plane_threshold_ratio * distance
    plane_height = float(np.median(flat[near] @ up))
    camera_height = float(np.median(component.centres @ up)) - plane_height
    if camera_height <= 0:
        raise DegenerateGeometry(
            "the cameras lie below the ground plane, so up is not determined; take photos that show more of the ground"
        )
    return Gravity(
        up=up,
        sigma_deg=float(np.degrees(np.sqrt(1 / values[1]))),
        plane_height=plane_height,
        camera_height=camera_height,
        method=f"{method} and {len(component.cameras)} cameras level to {roll_deg:.1f} deg" if determined else method,
        disagreement_deg=_angle_deg(cameras_up, normal) if determined else float("nan"),
    )


def level_from_gravity(component: Component, gravity: Gravity) -> Similarity:
    """The `level` frame: z up, ground at z = 0, cameras' mean at x = y = 0, and their median height above ground 1.

    With this unit, a model's scale in metres is its flying height: a number with a known plausible range.
    """
    z = gravity.up
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    scale = 1 / gravity.camera_height
    middle = rotation @ component.centres.mean(axis=0)
    return Similarity(scale, rotation, -scale * np.array([middle[0], middle[1], gravity.plane_height]))


def horizon_information(component: Component, up: Array, options: OrientOptions) -> tuple[Array, float]:
    """Information (3, 3), rad^-2, of up from the cameras' horizontal axes, and the sigma of their roll in degrees.

    A photo stored on its side has a horizontal y-axis. Robust by reweighting (Cauchy).
    """
    axes = np.array([camera.cam_from_world.rotation for camera in component.cameras])
    off_x, off_y = np.abs(axes[:, 0] @ up), np.abs(axes[:, 1] @ up)
    sideways = (off_x > np.sin(np.radians(options.portrait_deg))) & (off_y < off_x)
    horizontal = np.where(sideways[:, None], axes[:, 1], axes[:, 0])
    sigma, weights = np.radians(10.0), np.ones(len(horizontal))
    slope = np.radians(options.terrain_slope_deg)
    for _ in range(10):
        information = _information(horizontal, weights / sigma**2, np.radians(options.common_roll_deg))
        prior = (np.eye(3) - np.outer(up, up)) / slope**2
        direction = np.linalg.eigh(information + prior)[1][:, 0]
        residual = horizontal @ direction
        sigma = max(1.4826 * float(np.median(np.abs(residual))), np.radians(options.roll_floor_deg))
        weights = 1 / (1 + (residual / (2.4 * sigma)) ** 2)
    return np.asarray(information), float(np.degrees(sigma))


def _information(axes: Array, weights: Array, common: float) -> Array:
    """Normal matrix (3, 3) of axes (n, 3) with independent errors and one error common to all (Woodbury)."""
    total = axes.T @ weights
    return np.asarray((axes.T * weights) @ axes - np.outer(total, total) / (1 / common**2 + weights.sum()))


def _ground_plane(points: Array, threshold: float, rng: np.random.Generator) -> Plane:
    try:
        plane, _ = fit_plane_ransac(points, threshold=threshold, rng=rng)
    except TooFewMatches as error:
        raise DegenerateGeometry(f"too few points for a ground plane: {error}") from error
    return plane


def _sign(normal: Array, rays: Array) -> float:
    """+1 if most viewing rays arrive from the side to which the normal points (the paper's rule), else -1.

    Rays to observed ground points are counted, not optical axes: ground cameras point slightly upwards.
    """
    return 1.0 if np.mean(rays @ normal < 0) >= 0.5 else -1.0


def _angle_deg(a: Array, b: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))
