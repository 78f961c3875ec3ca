# SPDX-License-Identifier: Apache-2.0
"""Cameras of other programs' files see the points where the cameras that were written see them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from skymoor.errors import InputError
from skymoor.geometry import Intrinsics, Similarity
from skymoor.models import Cloud, read_model
from skymoor.models.cameras import without_distortion
from skymoor.models.posed import Posed, component_of_posed
from skymoor.types import Camera, Component
from support.given_models import write_ply

Array = NDArray[np.float64]

LENS = Intrinsics(640, 480, 500.0, 503.0, 322.0, 239.0, (-0.05, 0.01, 0.001, -0.002))
LENSES = {
    "OPENCV_FISHEYE": (300, 300, 320, 240, 0.01, -0.01, 0, 0),
    "FULL_OPENCV": (500, 500, 320, 240, -0.1, 0.02, 0.001, -0.001, 0.01, 0, 0, 0),
    "FOV": (400, 400, 320, 240, 0.7),
    "SIMPLE_RADIAL_FISHEYE": (300, 320, 240, 0.01),
    "THIN_PRISM_FISHEYE": (300, 300, 320, 240, 0.01, 0, 0, 0, 0, 0, 0.001, 0.001),
    "SIMPLE_DIVISION": (500, 320, 240, -0.05),
    "EUCM": (400, 400, 320, 240, 0.6, 1.1),
}


def scene(lens: Intrinsics = LENS, count: int = 900) -> tuple[list[Camera], Array, NDArray[np.uint8]]:
    """Five cameras 20 above rolling ground, each turned otherwise, and coloured points."""
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(-12, 12, (count, 2)), rng.normal(0, 1, count)])
    cameras = []
    for k in range(5):
        rotation = Rotation.from_euler("zyx", [40 * k, 8, 180 - 5 * k], degrees=True).as_matrix()
        centre = np.array([3.0 * k - 6, k % 2, 20.0])
        cameras.append(Camera(f"photo {k}.png", lens, Similarity(1.0, rotation, -rotation @ centre)))
    return cameras, points, rng.integers(1, 255, (count, 3), np.uint8)


def write_photos(folder: Path, cameras: list[Camera]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for camera in cameras:
        size = (camera.intrinsics.width, camera.intrinsics.height)
        Image.new("RGB", size, (90, 120, 60)).save(folder / camera.image)


def require_same(component: Component | None, cameras: list[Camera], points: Array, *, within_px: float = 1e-3) -> None:
    assert component is not None and len(component.cameras) == len(cameras)
    found = {camera.image: camera for camera in component.cameras}
    for camera in cameras:
        other = found[camera.image]
        at = [one.intrinsics.px_from_cam(one.cam_from_world.apply(points)) for one in (camera, other)]
        seen = np.isfinite(at[0]).all(axis=1)
        assert seen.sum() > 300 and np.abs(at[0] - at[1])[seen].max() < within_px
    assert len(component.obs_point) > 500
    assert (component.obs_px >= 0).all()


def world_from_gl(camera: Camera) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = camera.cam_from_world.rotation.T @ np.diag([1.0, -1, -1])
    pose[:3, 3] = camera.centre
    return pose


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_a_dataset_that_colmap_synthesised(kind: str, tmp_path: Path) -> None:
    """Two rigs of six images: what its observations show is where its cameras, as they are read, see its points."""
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=2, num_cameras_per_rig=1, num_frames_per_rig=6, num_points3D=600
    )
    made = pycolmap.synthesize_dataset(options)
    (made.write if kind == "bin" else made.write_text)(str(tmp_path))
    model = read_model([tmp_path])
    component = model.component
    assert component is not None and len(component.cameras) == 12 and isinstance(model.surface, Cloud)
    assert len(model.surface.points) == 600 and len(component.obs_px) == made.compute_num_observations()
    errors = [
        component.cameras[k].intrinsics.px_from_cam(
            component.cameras[k].cam_from_world.apply(component.points[p][None])
        )
        - px
        for k, p, px in zip(component.obs_camera, component.obs_point, component.obs_px, strict=True)
    ]
    assert np.abs(np.concatenate(errors)).max() < 1e-3


def test_nerfstudio(tmp_path: Path) -> None:
    cameras, points, colours = scene()
    write_photos(tmp_path / "images", cameras)
    write_ply(tmp_path / "sparse.ply", points, colours, kind="f8")
    k1, k2, p1, p2 = LENS.distortion
    content = {"w": 640, "h": 480, "fl_x": LENS.fx, "fl_y": LENS.fy, "cx": LENS.cx, "cy": LENS.cy}
    content |= {"k1": k1, "k2": k2, "p1": p1, "p2": p2, "ply_file_path": "sparse.ply", "camera_model": "OPENCV"}
    frames = [{"file_path": f"images/{c.image}", "transform_matrix": world_from_gl(c).tolist()} for c in cameras]
    (tmp_path / "transforms.json").write_text(json.dumps(content | {"frames": frames}))
    model = read_model([tmp_path])
    named = [Camera(f"images/{c.image}", c.intrinsics, c.cam_from_world) for c in cameras]
    require_same(model.component, named, points)
    assert model.photos is not None and model.photos.read(named[0].image).shape == (480, 640, 3)
    assert [part.kind for part in model.parts] == ["nerfstudio", "ply"] and model.sparse


def test_opensfm(tmp_path: Path) -> None:
    cameras, points, colours = scene()
    side, (k1, k2, p1, p2) = 640.0, LENS.distortion
    lens = {"projection_type": "brown", "width": 640, "height": 480, "focal_x": LENS.fx / side}
    lens |= {"focal_y": LENS.fy / side, "c_x": (LENS.cx - 320) / side, "c_y": (LENS.cy - 240) / side}
    lens |= {"k1": k1, "k2": k2, "k3": 0.0, "p1": p1, "p2": p2}
    shots = {
        c.image: {
            "camera": "a",
            "rotation": Rotation.from_matrix(c.cam_from_world.rotation).as_rotvec().tolist(),
            "translation": c.cam_from_world.translation.tolist(),
        }
        for c in cameras
    }
    ties = {
        str(k): {"coordinates": p.tolist(), "color": c.tolist()}
        for k, (p, c) in enumerate(zip(points, colours, strict=True))
    }
    largest = {"cameras": {"a": lens}, "shots": shots, "points": ties}
    (tmp_path / "reconstruction.json").write_text(json.dumps([{"cameras": {}, "shots": {}}, largest]))
    model = read_model([tmp_path])
    require_same(model.component, cameras, points)
    assert model.photos is None and any("--photos" in note for note in model.notes)
    assert any("2 reconstructions" in note for note in model.notes)


def test_bundler(tmp_path: Path) -> None:
    lens = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0, (-0.05, 0.01, 0.0, 0.0))
    cameras, points, colours = scene(lens)
    write_photos(tmp_path, cameras)
    names = [camera.image.replace(" ", "_") for camera in cameras]
    for camera, name in zip(cameras, names, strict=True):
        (tmp_path / camera.image).rename(tmp_path / name)
    flip, lines = np.diag([1.0, -1, -1]), ["# Bundle file v0.3", f"{len(cameras)} {len(points)}"]
    for camera in cameras:
        pose = camera.cam_from_world
        lines += ["500 -0.05 0.01", *(" ".join(map(repr, row)) for row in (flip @ pose.rotation).tolist())]
        lines.append(" ".join(map(repr, (flip @ pose.translation).tolist())))
    for xyz, rgb in zip(points.tolist(), colours.tolist(), strict=True):
        lines += [" ".join(map(repr, xyz)), " ".join(map(str, rgb)), "1 0 0 1.0 2.0"]
    (tmp_path / "bundle.out").write_text("\n".join(lines) + "\n")
    (tmp_path / "list.txt").write_text("\n".join(names) + "\n")
    model = read_model([tmp_path / "bundle.out"])
    named = [Camera(name, c.intrinsics, c.cam_from_world) for name, c in zip(names, cameras, strict=True)]
    require_same(model.component, named, points)
    assert model.photos is not None
    (tmp_path / "list.txt").unlink()
    assert read_model([tmp_path / "bundle.out"]).component is None


def metashape_xml(cameras: list[Camera], transform: str = "") -> str:
    k1, k2, p1, p2 = LENS.distortion
    lens = f"<f>{LENS.fy}</f><b1>{LENS.fx - LENS.fy}</b1><cx>{LENS.cx - 320}</cx><cy>{LENS.cy - 240}</cy>"
    lens += f"<k1>{k1}</k1><k2>{k2}</k2><p1>{p2}</p1><p2>{p1}</p2>"
    size = '<resolution width="640" height="480"/>'
    sensor = f'<sensor id="0" type="frame">{size}<calibration class="adjusted">{size}{lens}</calibration></sensor>'
    nodes = []
    for k, camera in enumerate(cameras):
        pose = np.linalg.inv(camera.cam_from_world.matrix())
        numbers = " ".join(map(repr, pose.ravel().tolist()))
        nodes.append(f'<camera id="{k}" sensor_id="0" label="{camera.image}"><transform>{numbers}</transform></camera>')
    inside = f"<sensors>{sensor}</sensors><cameras>{''.join(nodes)}</cameras>{transform}"
    return f'<document version="2.0.0"><chunk label="a">{inside}</chunk></document>'


def test_metashape_beside_its_cloud(tmp_path: Path) -> None:
    cameras, points, colours = scene()
    write_ply(tmp_path / "cloud.ply", points, colours, kind="f8")
    (tmp_path / "cameras.xml").write_text(metashape_xml(cameras))
    model = read_model([tmp_path / "cloud.ply", tmp_path / "cameras.xml"])
    require_same(model.component, cameras, points)
    assert isinstance(model.surface, Cloud) and not model.sparse
    georeferenced = "<transform><scale>3</scale></transform><reference>GEOGCS[]</reference>"
    (tmp_path / "cameras.xml").write_text(metashape_xml(cameras, georeferenced))
    with pytest.raises(InputError, match="georeferenced"):
        read_model([tmp_path / "cloud.ply", tmp_path / "cameras.xml"])


def test_entities_are_not_expanded(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text('<document/><!DOCTYPE a [<!ENTITY b "c">]>')
    _, points, colours = scene()
    write_ply(tmp_path / "cloud.ply", points, colours)
    with pytest.raises(InputError, match="entities"):
        read_model([tmp_path / "cloud.ply", tmp_path / "a.xml"])


@pytest.mark.parametrize("name", sorted(LENSES))
def test_a_lens_that_is_not_browns_is_resampled(name: str) -> None:
    params = tuple(map(float, LENSES[name]))
    cameras, points, _ = scene()
    posed = [
        Posed(c.image, name, 640, 480, params, c.cam_from_world.rotation, c.cam_from_world.translation) for c in cameras
    ]
    component, _ = component_of_posed(posed, points, None, {}, Path("m"))
    lens = component.cameras[0].intrinsics
    assert not any(lens.distortion)
    model = pycolmap.Reconstruction()
    own = pycolmap.Camera(model=name, width=640, height=480, params=list(params), camera_id=1)
    model.add_camera_with_trivial_rig(own)
    model.add_image_with_trivial_frame(pycolmap.Image(name="a", camera_id=1, image_id=1), pycolmap.Rigid3d())
    replaced = without_distortion(model, Path("m"))["a"]
    u, v = np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5)
    ramp = np.dstack([u / 640 * 255, v / 480 * 255, np.full(u.shape, 255)]).astype(np.uint8)
    image = replaced.resampled(ramp)
    assert image.shape == (lens.height, lens.width, 3)
    rays = np.array([[0.1, 0.05, 1.0], [-0.2, 0.1, 1.0], [0.25, -0.2, 1.0]])
    original = np.array([own.img_from_cam(ray) for ray in rays])
    px = lens.px_from_cam(rays).astype(int)
    assert np.abs(image[px[:, 1], px[:, 0], :2] / 255 * [640, 480] - original).max() < 5


def test_a_panorama_has_no_pinhole_form(tmp_path: Path) -> None:
    cameras, points, _ = scene()
    posed = [Posed(c.image, "EQUIRECTANGULAR", 640, 320, (), np.eye(3), np.zeros(3)) for c in cameras]
    with pytest.raises(InputError):
        component_of_posed(posed, points, None, {}, tmp_path)


def test_photos_of_another_size_are_told(tmp_path: Path) -> None:
    cameras, points, colours = scene()
    write_photos(tmp_path, cameras)
    Image.new("RGB", (320, 240)).save(tmp_path / cameras[2].image)
    posed = [
        Posed(c.image, "SIMPLE_PINHOLE", 640, 480, (500.0, 320.0, 240.0), *(c.cam_from_world.rotation, c.centre))
        for c in cameras
    ]
    files = {c.image: tmp_path / c.image for c in cameras}
    with pytest.raises(InputError, match="320 by 240 pixels"):
        component_of_posed(posed, points, colours, files, tmp_path)
