# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from skymoor.engines.colmap import colmap_from_component as colmap_model
from skymoor.engines.colmap import component_from_colmap
from skymoor.geometry import Intrinsics, Similarity
from skymoor.types import Camera, Component

SHARED = Intrinsics(640, 480, 500.0, 505.0, 321.0, 238.0, (-0.1, 0.02, 0.001, -0.002))
OTHER = Intrinsics(800, 600, 700.0, 700.0, 400.0, 300.0)


@pytest.fixture
def component() -> Component:
    """Four cameras 100 m above 50 points, with exact observations in all of them but the first point's."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-25, 25, (50, 2)), rng.uniform(0, 5, 50)])
    cameras = []
    for k, intrinsics in enumerate((SHARED, SHARED, OTHER, SHARED)):
        rotation = Rotation.from_euler("xz", [180 + 3 * k, 40 * k], degrees=True).as_matrix()
        centre = np.array([3.0 * k, -2.0 * k, 100.0])
        cameras.append(Camera(f"air/{k}.jpg", intrinsics, Similarity(1.0, rotation, -rotation @ centre)))
    camera_index, point_index = (index.ravel() for index in np.mgrid[0:4, 0:50])
    seen = (point_index > 0) | (camera_index < 2)
    order = rng.permutation(np.flatnonzero(seen))
    camera_index, point_index = camera_index[order], point_index[order]
    px = np.array(
        [
            cameras[c].intrinsics.px_from_cam(cameras[c].cam_from_world.apply(points[p]))[0]
            for c, p in zip(camera_index, point_index, strict=True)
        ]
    )
    colours = rng.integers(0, 256, (50, 3), np.uint8)
    return Component(
        tuple(cameras), points, colours, camera_index.astype(np.int32), point_index.astype(np.int32), px, 0.0
    )


@pytest.fixture
def read_back(component: Component, tmp_path: Path) -> pycolmap.Reconstruction:
    colmap_model(component).write(tmp_path)
    return pycolmap.Reconstruction(tmp_path)


def test_every_observation_reprojects(component: Component, read_back: pycolmap.Reconstruction) -> None:
    seen = 0
    for image in read_back.images.values():
        for point in image.get_observation_points2D():
            px = image.project_point(read_back.point3D(point.point3D_id).xyz)
            np.testing.assert_allclose(px, point.xy, atol=1e-6)
            seen += 1
    assert seen == len(component.obs_px) == 198
    assert read_back.compute_mean_reprojection_error() < 1e-6


def test_structure(component: Component, read_back: pycolmap.Reconstruction) -> None:
    assert read_back.num_reg_images() == read_back.num_reg_frames() == 4
    assert read_back.num_cameras() == read_back.num_rigs() == 2
    assert {camera.model.name for camera in read_back.cameras.values()} == {"OPENCV"}
    for camera in component.cameras:
        image = read_back.find_image_with_name(camera.image)
        np.testing.assert_allclose(image.projection_center(), camera.centre, atol=1e-9)
    tracks = sorted(point.track.length() for point in read_back.points3D.values())
    assert tracks == [2] + [4] * 49


def test_component_comes_back(component: Component, read_back: pycolmap.Reconstruction) -> None:
    again = component_from_colmap(read_back, {camera.image: camera.image for camera in component.cameras})
    assert [camera.image for camera in again.cameras] == [camera.image for camera in component.cameras]
    assert [camera.intrinsics for camera in again.cameras] == [camera.intrinsics for camera in component.cameras]
    np.testing.assert_allclose(again.points, component.points)
    for ours, theirs in zip(component.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(theirs.cam_from_world.matrix(), ours.cam_from_world.matrix(), atol=1e-9)
    colours = np.array([read_back.point3D(k).color for k in sorted(read_back.point3D_ids())])
    np.testing.assert_array_equal(colours, component.colours)
