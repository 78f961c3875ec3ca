# SPDX-License-Identifier: Apache-2.0
"""Gravity of ground photos, by the vertical edges of buildings.

Photos around a building show so little of the ground that the plane with most points is the facade. But the edges of
windows, doors and corners are vertical, each photo shows dozens of them, and with known intrinsics an edge defines a
plane that contains the vertical. People hold cameras nearly level: that separates the vertical edges from all others,
and is the coarser estimate where there are too few. (Vanishing points: Caprile and Torre, IJCV 1990.)
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.errors import DegenerateGeometry
from skymoor.types import Array, Camera, Component, Gravity, Image, Mask, Photos

MAX_EDGE_DEG = (15.0, 10.0, 5.0)  # largest angle of an edge to the vertical, per iteration


@dataclass(frozen=True)
class UprightOptions:
    """How ground photos are held, and how vertical walls are.

    Attributes:
        roll_deg: standard deviation of the roll of a photo that a person takes.
        pitch_deg: the same of its pitch.
        min_edge_ratio: shortest edge that is used, relative to the photo's longer side.
        min_edges: with fewer vertical edges, the roll and pitch of the cameras alone decide.
        lean_deg: common lean of walls and posts: lower bound of the sigma of up.
        min_ground_points: with fewer labelled ground points, the height of the ground is that of the lowest points.
        eye_ratio: where no ground is visible, camera height above it as a share of the distance of the points.
    """

    roll_deg: float = 3.0
    pitch_deg: float = 10.0
    min_edge_ratio: float = 0.03
    min_edges: int = 30
    lean_deg: float = 0.15
    min_ground_points: int = 20
    eye_ratio: float = 0.15


def estimate_ground_gravity(
    component: Component, photos: Photos, options: UprightOptions | None = None, *, ground: Mask | None = None
) -> Gravity:
    """Estimate the up direction of a component of ground photos.

    The height of the ground is that of the near points that `ground` (n,) marks, see `ground_points`. Without them, or
    with too few, it is that of the lowest points: accurate to about a third of the cameras' height, and `camera_height`
    is too small where the foot of the walls is hidden.

    Raises:
        DegenerateGeometry: fewer than three cameras, or no points.
    """
    options = options or UprightOptions()
    if len(component.cameras) < 3 or not len(component.obs_point):
        raise DegenerateGeometry("the up direction needs at least three cameras and some points")
    held_up, sigma_deg = _up_of_cameras(component, options)
    edges = [_edges(camera, photos.read(camera.image), options) for camera in component.cameras]
    up, lines = held_up, 0
    for max_deg in MAX_EDGE_DEG:
        normals, weights = _upright_planes(component, edges, up, max_deg)
        lines = len(normals)
        if lines < options.min_edges:
            up = held_up
            break
        up, edges_deg = _direction_across(normals, weights, up)
        sigma_deg = float(np.hypot(edges_deg, options.lean_deg))
    plane_height, seen = _labelled_height(component, up, ground, options), "on labelled ground"
    if plane_height is None:
        plane_height, visible = _ground_height(component, up, options)
        seen = "" if visible else "no ground in sight"
    found = f"{lines} upright edges" if lines >= options.min_edges else f"{len(component.cameras)} cameras held level"
    return Gravity(
        up=up,
        sigma_deg=sigma_deg,
        plane_height=plane_height,
        camera_height=float(np.median(component.centres @ up)) - plane_height,
        method=", ".join(filter(None, (found, seen))),
        disagreement_deg=float(np.degrees(np.arccos(np.clip(up @ held_up, -1, 1)))),
    )


def _up_of_cameras(component: Component, options: UprightOptions) -> tuple[Array, float]:
    """Up by the roll and pitch of the cameras, and its standard deviation in degrees.

    In each photo either the rows or the columns are horizontal (some are stored on their side), and the optical axis
    nearly is. Several initial directions are tried, and the best fit is kept.
    """
    x, y, z = np.array([camera.cam_from_world.rotation for camera in component.cameras]).transpose(1, 0, 2)
    starts = [np.linalg.eigh(z.T @ z)[1][:, 0], *(axis.mean(axis=0) for axis in (x, y))]
    starts = [start / np.linalg.norm(start) for start in starts if np.linalg.norm(start) > 0.1]  # else it is noise
    _, up, information = min((_refined_up(x, y, z, start, options) for start in starts), key=lambda fit: fit[0])
    # A camera is held upright or on its side, not upside down; in front of walls most points are above the cameras.
    upright = float(np.sum(-y @ up))
    above = component.points[component.obs_point] - component.centres[component.obs_camera]
    vote = upright if abs(upright) > 0.3 * len(y) else float(np.median(above @ up))
    sigma = 1 / np.sqrt(max(float(np.linalg.eigvalsh(information)[1]), 1e-9))
    return up * (1.0 if vote >= 0 else -1.0), float(np.degrees(sigma))


def _refined_up(x: Array, y: Array, z: Array, up: Array, options: UprightOptions) -> tuple[float, Array, Array]:
    roll, pitch = np.radians(options.roll_deg), np.radians(options.pitch_deg)
    for _ in range(10):
        level = np.where((np.abs(x @ up) <= np.abs(y @ up))[:, None], x, y)
        # Robust against tilted photos.
        weights = 1 / (1 + (level @ up / (2.4 * roll)) ** 2)
        information = (level.T * weights) @ level / roll**2 + z.T @ z / pitch**2
        new = np.linalg.eigh(information)[1][:, 0]
        up = new if new @ up >= 0 else -new
    cost = np.log1p((level @ up / roll) ** 2).sum() + np.log1p((z @ up / pitch) ** 2).sum()
    return float(cost), up, np.asarray(information)


def _edges(camera: Camera, image: Image, options: UprightOptions) -> Array:
    """Straight edges (n, 2, 3) of a photo, as the rays to their ends in the camera's frame."""
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))[0]
    ends = np.zeros((0, 2, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2, 2)
    length_px = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ends = ends[length_px > options.min_edge_ratio * max(image.shape[:2])]
    # OpenCV's first pixel has its centre at (0, 0).
    return np.asarray(camera.intrinsics.rays(ends.reshape(-1, 2) + 0.5).reshape(-1, 2, 3))


def _upright_planes(component: Component, edges: list[Array], up: Array, max_deg: float) -> tuple[Array, Array]:
    """Unit normals (n, 3) of the planes of nearly vertical edges, and their weights (n,), in the world frame."""
    normals, weights = [np.zeros((0, 3))], [np.zeros(0)]
    for camera, ends in zip(component.cameras, edges, strict=True):
        rotation = camera.cam_from_world.rotation
        up_cam = rotation @ up
        middle = ends.mean(axis=1)
        image_up = up_cam[:2] - middle[:, :2] * up_cam[2]
        along = ends[:, 1, :2] - ends[:, 0, :2]
        size = np.linalg.norm(image_up, axis=1) * np.linalg.norm(along, axis=1)
        cosine = np.abs(np.sum(image_up * along, axis=1)) / np.maximum(size, 1e-12)
        upright = cosine > np.cos(np.radians(max_deg))
        across = np.cross(ends[upright, 0], ends[upright, 1]) @ rotation
        normals.append(across / np.linalg.norm(across, axis=1, keepdims=True))
        weights.append(np.sum(along[upright] ** 2, axis=1))
    return np.concatenate(normals), np.concatenate(weights)


def _direction_across(normals: Array, weights: Array, up: Array, floor_deg: float = 0.1) -> tuple[Array, float]:
    """The direction (3,) perpendicular to normals (n, 3), robust (Cauchy), and its standard deviation in degrees."""
    weights = weights / np.median(weights)
    sigma = np.radians(3.0)
    for _ in range(20):
        robust = weights / (1 + (normals @ up / (2.4 * sigma)) ** 2)
        values, vectors = np.linalg.eigh((normals.T * robust) @ normals)
        up = vectors[:, 0] * (1.0 if vectors[:, 0] @ up >= 0 else -1.0)
        sigma = max(1.4826 * float(np.median(np.abs(normals @ up))), float(np.radians(floor_deg)))
    return up, float(np.degrees(sigma / np.sqrt(max(float(values[1]), 1e-9))))


def _labelled_height(component: Component, up: Array, ground: Mask | None, options: UprightOptions) -> float | None:
    """Median height along `up` of the ground near the cameras; None for too few points, or points above them.

    Labels are wrong at the foot of objects, and distant ground may be higher or lower.
    """
    if ground is None:
        return None
    rays = component.points[component.obs_point] - component.centres[component.obs_camera]
    distance = np.linalg.norm(rays, axis=1)
    near = np.unique(component.obs_point[distance < 1.2 * np.median(distance)])
    marked = near[ground[near]]
    height = float(np.median(component.points[marked] @ up)) if len(marked) >= options.min_ground_points else np.inf
    return height if height < np.median(component.centres @ up) else None


def _ground_height(component: Component, up: Array, options: UprightOptions) -> tuple[float, bool]:
    """Height of the ground along `up`, and whether points that low exist."""
    rays = component.points[component.obs_point] - component.centres[component.obs_camera]
    distance = np.linalg.norm(rays, axis=1)
    middle = float(np.median(distance))
    near = component.obs_point[distance < 1.2 * middle]
    camera_level = float(np.median(component.centres @ up))
    lowest = float(np.percentile(component.points[near] @ up, 1.0))
    seen = lowest < camera_level - options.eye_ratio / 3 * middle
    return (lowest if seen else camera_level - options.eye_ratio * middle), seen
