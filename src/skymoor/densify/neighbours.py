# SPDX-License-Identifier: Apache-2.0
"""Selection of stereo partners, and the depth range of a photo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from skymoor.types import Array, Component


def stereo_partners(
    component: Component, *, count: int, best_angle_deg: float, max_angle_deg: float, min_shared: int = 30
) -> list[list[int]]:
    """Per camera, up to `count` partners: many shared points, a convergence near the best, different directions.

    Angles are measured at the shared points. Completeness falls off beyond about 25 degrees and accuracy below 8.
    """
    n = len(component.cameras)
    centres = component.centres
    ones = np.ones(len(component.obs_point), np.float32)
    observes = csr_matrix((ones, (component.obs_camera, component.obs_point)), shape=(n, len(component.points)))
    shared = (observes @ observes.T).toarray()
    # A camera without points (its middle is then the origin) shares none and gets no partner.
    middles = (observes @ component.points) / np.maximum(shared.diagonal(), 1)[:, None]
    partners: list[list[int]] = []
    for i in range(n):
        to_i = _unit(centres[i] - middles[i])
        angles = np.degrees(np.arccos(np.clip(_unit(centres - middles[i]) @ to_i, -1, 1)))
        score = shared[i] * np.exp(-0.5 * (np.log(np.maximum(angles, 0.1) / best_angle_deg) / 0.5) ** 2)
        score[(angles > max_angle_deg) | (shared[i] < min_shared)] = 0
        score[i] = 0
        partners.append(_spread(score, _unit(centres - centres[i]), count))
    return partners


def _spread(score: NDArray[np.float64], directions: Array, count: int) -> list[int]:
    """Greedy choice; the score of a baseline parallel to a chosen one is reduced."""
    score = score.copy()
    chosen: list[int] = []
    while len(chosen) < count and score.max() > 0:
        best = int(np.argmax(score))
        chosen.append(best)
        score *= 1 - 0.6 * np.abs(directions @ directions[best]) ** 4
        score[best] = 0
    return chosen


def depth_range(component: Component, camera: int, *, margin: float = 0.25) -> tuple[float, float]:
    """Nearest and farthest z-depth to search in a camera, from its sparse points with a margin."""
    points = component.points[component.obs_point[component.obs_camera == camera]]
    depth = component.cameras[camera].cam_from_world.apply(points)[:, 2]
    depth = depth[depth > 0]
    near, middle, far = np.percentile(depth, [1, 50, 98])
    # Roofs and tree tops have few points: surfaces above the nearest point must still be within the range.
    return float(max(near - margin * (middle - near) - 0.08 * middle, 0.2 * near)), float(
        far + margin * (far - middle) + 0.05 * far
    )


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
