# SPDX-License-Identifier: Apache-2.0
"""What trainers of radiance fields and Gaussian splats open, read by COLMAP, plyfile and OpenCV."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from plyfile import PlyData

from skymoor.engines.colmap import write_colmap
from skymoor.results.export import export
from skymoor.results.formats.splat_training import pinhole_of
from skymoor.results.read import Result
from support.exported_run import LENS, cameras, component, points, write_run

SIZE = (LENS.width, LENS.height)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small run, with photos whose red is the column and whose green is the row."""
    root = tmp_path_factory.mktemp("training")
    folder = write_run(root)
    u, v = np.meshgrid(np.arange(LENS.width) + 0.5, np.arange(LENS.height) + 0.5)
    picture = np.dstack([u * 0.75, v, np.zeros_like(u)]).astype(np.uint8)
    for camera in cameras():
        Image.fromarray(picture).save(root / camera.image, **({"quality": 100} if "jpg" in camera.image else {}))
    return folder


def test_splat_trainers_find_pinhole_cameras_and_photos_without_distortion(run: Path, tmp_path: Path) -> None:
    export(Result.read(run), ["splat-training"], tmp_path, lambda _: None)
    folder = tmp_path / "splat-training" / "airborne_0"
    assert {path.name for path in (folder / "sparse" / "0").glob("*3D.bin")} == {"points3D.bin"}
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    model.update_point_3d_errors()
    assert max(point.error for point in model.points3D.values()) < 0.01
    assert len(model.points3D) > 50
    known = {camera.image.rpartition("/")[2]: camera for camera in cameras()[:4]}
    assert {image.name for image in model.images.values()} == set(known)
    for image in model.images.values():
        np.testing.assert_allclose(image.projection_center(), known[image.name].centre, atol=1e-9)
        pixels = cv2.imread(str(folder / "images" / image.name))
        camera = model.camera(image.camera_id)
        assert pixels.shape[:2] == (camera.height, camera.width)
        u, v = np.meshgrid(np.arange(5, camera.width - 5, 20) + 0.5, np.arange(5, camera.height - 5, 20) + 0.5)
        fx, fy, cx, cy = camera.params
        rays = np.column_stack([(u.ravel() - cx) / fx, (v.ravel() - cy) / fy, np.ones(u.size)])
        lens = np.array([[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1]])
        want, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), lens, np.array(LENS.distortion))
        found = pixels[v.astype(int), u.astype(int)].reshape(-1, 3)[:, [2, 1]] / [0.75, 1]
        gap = np.abs(found + 0.5 - want[:, 0])
        assert 0.05 < np.median(gap) < 1 and gap.max() < 4  # whole levels of grey, and JPEG
    assert json.loads((folder / "georeference.json").read_text())["frame"].startswith("east-north-up")


def test_photos_without_distortion_are_copied_as_they_are(tmp_path: Path) -> None:
    folder, flat = write_run(tmp_path), LENS.undistorted()
    plain = component()
    posed = tuple(replace(camera, intrinsics=flat) for camera in plain.cameras)
    px = np.array(
        [
            flat.px_from_cam(posed[c].cam_from_world.apply(plain.points[[p]]))[0]
            for c, p in zip(plain.obs_camera, plain.obs_point, strict=True)
        ]
    )
    write_colmap(replace(plain, cameras=posed, obs_px=px), folder / "colmap" / "airborne_0")
    export(Result.read(folder), ["splat-training"], tmp_path / "out", lambda _: None)
    own = tmp_path / "out" / "splat-training" / "airborne_0"
    assert (own / "images" / "p0.jpg").read_bytes() == (tmp_path / "air" / "p0.jpg").read_bytes()
    assert pinhole_of(flat) == flat
    camera = next(iter(pycolmap.Reconstruction(str(own / "sparse" / "0")).cameras.values()))
    np.testing.assert_allclose(camera.params, [LENS.fx, LENS.fy, LENS.cx, LENS.cy])


def test_nerfstudio_names_a_cloud_in_the_frame_of_the_poses(run: Path, tmp_path: Path) -> None:
    export(Result.read(run), ["nerfstudio"], tmp_path, lambda _: None)
    told = json.loads((tmp_path / "nerfstudio" / "transforms.json").read_text())
    cloud = PlyData.read(tmp_path / "nerfstudio" / told["ply_file_path"])["vertex"]
    found = np.column_stack([cloud[axis] for axis in "xyz"])
    gap = np.linalg.norm(found[:, None] - points()[None], axis=2).min(axis=1)
    assert 50 < len(found) <= 60 and gap.max() < 1e-6
    assert {int(grey) for name in ("red", "green", "blue") for grey in cloud[name]} == {90}
    # The cloud lies before every camera: OpenGL looks along -z.
    for frame in told["frames"]:
        cam = (np.linalg.inv(np.array(frame["transform_matrix"])) @ np.column_stack([found, np.ones(len(found))]).T).T
        assert cam[:, 2].min() > -90 and cam[:, 2].max() < -40
