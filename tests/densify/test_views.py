# SPDX-License-Identifier: Apache-2.0
"""Photos reduced and without distortion: a point stays on what it shows."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from skymoor.densify import empty_depth_map
from skymoor.densify.views import reduced, undistorted
from skymoor.geometry import Intrinsics, Similarity
from skymoor.store import Store, find_photos
from skymoor.types import Camera

LENS = Intrinsics(160, 120, 130.0, 130.0, 80.0, 60.0, (-0.2, 0.05, 0.0, 0.0))
CAMERA = Camera("a.png", LENS, Similarity.identity())
POINTS = np.array([[-0.35, -0.2, 1.0], [0.3, 0.25, 1.0], [0.0, 0.0, 1.0]])


def dotted() -> np.ndarray:
    """A photo of three lights."""
    v, u = np.mgrid[:120, :160] + 0.5
    grey = sum(np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8) for x, y in LENS.px_from_cam(POINTS))
    return np.repeat((250 * np.clip(grey, 0, 1)).astype(np.uint8)[..., None], 3, axis=2)


def centroids(rgb: np.ndarray, px: np.ndarray, radius: int) -> np.ndarray:
    found = []
    for x, y in px:
        u, v = int(x), int(y)
        window = rgb[v - radius : v + radius + 1, u - radius : u + radius + 1, 0].astype(float)
        rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1] + 0.5
        found.append([u + (window * columns).sum() / window.sum(), v + (window * rows).sum() / window.sum()])
    return np.array(found)


def test_points_stay_on_what_they_show() -> None:
    for camera, rgb, radius in (
        (*undistorted(CAMERA, dotted()), 8),
        (*reduced(CAMERA, dotted(), 80), 4),
        (*undistorted(*reduced(CAMERA, dotted(), 80)), 4),
    ):
        px = camera.intrinsics.px_from_cam(POINTS)
        np.testing.assert_allclose(centroids(rgb, px, radius), px, atol=0.15)
    assert reduced(CAMERA, dotted(), 500)[0].intrinsics == LENS


def test_a_photo_without_depth_is_as_large_as_one_with(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in "abc":
        cv2.imwrite(str(folder / f"{name}.png"), dotted())
    with Store.open(tmp_path / "run") as store:
        photos = store.photos("photos", find_photos([folder], folder))
        found = empty_depth_map(CAMERA, photos, 80)
    assert found.depth.shape == (60, 80) == found.rgb.shape[:2]
    assert np.isnan(found.depth).all()
    assert not any(found.camera.intrinsics.distortion)
    assert len(found.points()[0]) == 0
