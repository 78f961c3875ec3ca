# SPDX-License-Identifier: Apache-2.0
"""Ground points of a component, by segmentation of the photos (paper, section 3.1, gravity vector estimation)."""

from __future__ import annotations

import numpy as np

from skymoor.orient.protocol import GroundLabeler
from skymoor.types import Component, Mask, Photos, Progress, no_progress


def ground_points(
    component: Component, photos: Photos, labeler: GroundLabeler, *, progress: Progress = no_progress
) -> Mask:
    """Whether each point (n,) is ground in most of the photos that see it."""
    votes, seen = np.zeros(len(component.points)), np.zeros(len(component.points))
    for k, camera in enumerate(component.cameras):
        mine = component.obs_camera == k
        if mine.any():
            labels = labeler(photos.read(camera.image))
            rows, columns = labels.shape
            u, v = np.floor(component.obs_px[mine]).astype(np.intp).T
            ground = labels[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)]
            np.add.at(votes, component.obs_point[mine], ground)
            np.add.at(seen, component.obs_point[mine], 1)
        progress(k + 1, len(component.cameras))
    return np.asarray(votes > seen / 2)
