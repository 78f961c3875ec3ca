# SPDX-License-Identifier: Apache-2.0
"""Small valid models of other programs."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyproj
from fuzz_files import CRS, picture, raster, write_photos
from numpy.typing import NDArray
from PIL import Image

from skymoor.engines.colmap import write_colmap
from skymoor.geometry import Intrinsics, Similarity
from skymoor.models.spz import spz_of_splat
from skymoor.results.formats.copc import write_copc
from skymoor.types import Camera, Component

Array = NDArray[np.float64]


def cloud(count: int = 700) -> tuple[Array, NDArray[np.uint8]]:
    """Points (n, 3) of a place with relief, and colours."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 30, (count, 2))
    return np.column_stack([xy, 2 * np.sin(xy[:, 0] / 4) + xy[:, 1] / 20]), rng.integers(1, 255, (count, 3), np.uint8)


def grid_mesh() -> tuple[Array, NDArray[np.int64]]:
    """Vertices (676, 3) and triangles."""
    x, y = np.meshgrid(np.arange(26.0), np.arange(26.0))
    corner = (np.arange(25)[:, None] * 26 + np.arange(25)).ravel()
    faces = [
        np.column_stack([corner, corner + 1, corner + 26]),
        np.column_stack([corner + 1, corner + 27, corner + 26]),
    ]
    return np.column_stack([x.ravel(), y.ravel(), np.sin(x / 3).ravel()]), np.concatenate(faces)


def block(photos_in: Path | None) -> Component:
    """Four cameras above the cloud, with what they see."""
    points, colours = cloud()
    lens = Intrinsics(96, 72, 80.0, 80.0, 48.0, 36.0, (0.0, 0.0, 0.0, 0.0))
    cameras, seen = [], []
    for k in range(4):
        centre = np.array([10.0 + 3 * k, 15.0, 40.0])
        rotation = np.diag([1.0, -1.0, -1.0])
        cameras.append(Camera(f"{k}.png", lens, Similarity(1.0, rotation, -rotation @ centre)))
        px = lens.px_from_cam(cameras[k].cam_from_world.apply(points))
        seen.append((px, ((px > 0) & (px < [96, 72])).all(axis=1)))
    camera, point = np.nonzero([inside for _, inside in seen])
    px = np.array([seen[c][0][p] for c, p in zip(camera, point, strict=True)])
    if photos_in is not None:
        write_photos(photos_in, 4)
    return Component(tuple(cameras), points, colours, camera.astype(np.int32), point.astype(np.int32), px, 0.5)


def colmap_binary(folder: Path) -> None:
    (folder / "sparse/0").mkdir(parents=True)
    write_colmap(block(folder / "images"), folder / "sparse/0")


def colmap_text(folder: Path) -> None:
    import pycolmap

    colmap_binary(folder)
    model = pycolmap.Reconstruction(str(folder / "sparse/0"))
    shutil.rmtree(folder / "sparse/0")
    (folder / "sparse/0").mkdir()
    model.write_text(str(folder / "sparse/0"))


def ply_bytes(points: Array, colours: NDArray[np.uint8] | None, faces: NDArray[np.int64] | None = None) -> bytes:
    fields = [(axis, "<f4") for axis in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")] * (
        colours is not None
    )
    rows = np.empty(len(points), fields)
    rows["x"], rows["y"], rows["z"] = points.T
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    head += [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in fields]
    if colours is not None:
        rows["red"], rows["green"], rows["blue"] = colours.T
    body = rows.tobytes()
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        corners = np.empty(len(faces), [("n", "u1"), ("k", "<i4", 3)])
        corners["n"], corners["k"] = 3, faces
        body += corners.tobytes()
    return "\n".join([*head, "end_header\n"]).encode() + body


def ply(folder: Path) -> None:
    (folder / "m.ply").write_bytes(ply_bytes(*cloud()))


def ply_mesh(folder: Path) -> None:
    vertices, faces = grid_mesh()
    (folder / "m.ply").write_bytes(ply_bytes(vertices, None, faces))


def ply_text(folder: Path) -> None:
    points, _ = cloud()
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    rows = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in points)
    (folder / "m.ply").write_text(f"{head}end_header\n{rows}\n")


def splats() -> NDArray[Any]:
    points, _ = cloud()
    names = [
        *"xyz",
        "f_dc_0",
        "f_dc_1",
        "f_dc_2",
        "opacity",
        "scale_0",
        "scale_1",
        "scale_2",
        *(f"rot_{k}" for k in range(4)),
    ]
    vertex = np.zeros(len(points), [(name, "<f4") for name in names])
    vertex["x"], vertex["y"], vertex["z"] = points.T
    vertex["opacity"], vertex["rot_0"] = 3.0, 1.0
    return vertex


def ply_splat(folder: Path) -> None:
    vertex = splats()
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}"]
    head += [f"property float {name}" for name in vertex.dtype.names or ()]
    (folder / "m.ply").write_bytes("\n".join([*head, "end_header\n"]).encode() + vertex.tobytes())


def spz(folder: Path) -> None:
    (folder / "m.spz").write_bytes(spz_of_splat(splats()))


def obj(folder: Path) -> None:
    vertices, faces = grid_mesh()
    lines = ["mtllib m.mtl", "usemtl a", *(f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in vertices)]
    lines += [f"vt {x / 25:.3f} {y / 25:.3f}" for x, y, _ in vertices]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in face) for face in faces.tolist()]
    (folder / "m.obj").write_text("\n".join(lines) + "\n")
    (folder / "m.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd wall.png\n")
    Image.fromarray(picture()).save(folder / "wall.png")


def gltf_of() -> tuple[dict[str, Any], bytes]:
    vertices, faces = grid_mesh()
    body = vertices.astype("<f4").tobytes() + faces.astype("<u4").tobytes()
    at, ends = vertices.size * 4, {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [0, 0, 0, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3", **ends},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": at},
            {"buffer": 0, "byteOffset": at, "byteLength": len(body) - at},
        ],
        "buffers": [{"byteLength": len(body)}],
    }
    return content, body


def gltf(folder: Path) -> None:
    content, body = gltf_of()
    content["buffers"][0]["uri"] = "m.bin"
    (folder / "m.gltf").write_text(json.dumps(content))
    (folder / "m.bin").write_bytes(body)


def glb(folder: Path) -> None:
    content, body = gltf_of()
    inner = json.dumps(content).encode()
    inner += b" " * (-len(inner) % 4)
    chunks = struct.pack("<I4s", len(inner), b"JSON") + inner + struct.pack("<I4s", len(body), b"BIN\0") + body
    (folder / "m.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _las(path: Path) -> Path:
    points, colours = cloud()
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-3), np.zeros(3)
    header.add_crs(pyproj.CRS.from_user_input(CRS))
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T
    data.red, data.green, data.blue = colours.astype(np.uint16).T * np.uint16(257)
    data.write(path)
    return path


def las(folder: Path) -> None:
    _las(folder / "m.las")


def laz(folder: Path) -> None:
    _las(folder / "m.laz")


def copc(folder: Path) -> None:
    source = _las(folder.parent / "source.laz")
    write_copc(source, folder / "m.copc.laz", np.random.default_rng(0))
    source.unlink()


def e57(folder: Path) -> None:
    import pye57

    points, _ = cloud()
    file = pye57.E57(str(folder / "m.e57"), mode="w")
    file.write_scan_raw({f"cartesian{axis}": column for axis, column in zip("XYZ", points.T, strict=True)})
    file.close()


def orthophoto(folder: Path) -> None:
    raster(folder / "ortho.tif", picture(80, 80).transpose(2, 0, 1))
    raster(folder / "dsm.tif", np.random.default_rng(0).normal(10, 1, (1, 80, 80)).astype(np.float32))


def nerfstudio(folder: Path) -> None:
    component = block(folder / "images")
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = []
    for camera in component.cameras:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.cam_from_world.rotation, camera.cam_from_world.translation
        frames.append(
            {"file_path": f"images/{camera.image}", "transform_matrix": (np.linalg.inv(pose) @ flip).tolist()}
        )
    lens = {"w": 96, "h": 72, "fl_x": 80.0, "fl_y": 80.0, "cx": 48.0, "cy": 36.0, "k1": 0.01, "camera_model": "OPENCV"}
    content = {**lens, "ply_file_path": "cloud.ply", "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(content))
    (folder / "cloud.ply").write_bytes(ply_bytes(*cloud()))


def opensfm(folder: Path) -> None:
    component = block(folder / "images")
    points, colours = cloud()
    turn = [float(np.pi), 0.0, 0.0]
    lens = {
        "projection_type": "brown",
        "width": 96,
        "height": 72,
        "focal_x": 0.83,
        "focal_y": 0.83,
        "c_x": 0.0,
        "k1": 0.0,
    }
    shots = {
        one.image: {"camera": "c", "rotation": turn, "translation": one.cam_from_world.translation.tolist()}
        for one in component.cameras
    }
    found = {
        str(k): {"coordinates": xyz, "color": rgb}
        for k, (xyz, rgb) in enumerate(zip(points.tolist(), colours.tolist(), strict=True))
    }
    content = [{"cameras": {"c": lens}, "shots": shots, "points": found}]
    (folder / "reconstruction.json").write_text(json.dumps(content))


def bundler(folder: Path) -> None:
    component = block(folder / "images")
    points, colours = cloud()
    lines = ["# Bundle file v0.3", f"{len(component.cameras)} {len(points)}"]
    back = np.diag([1.0, -1.0, -1.0])
    for one in component.cameras:
        rows = [*(back @ one.cam_from_world.rotation), back @ one.cam_from_world.translation]
        lines += ["80.0 0.0 0.0", *(" ".join(f"{value:.6f}" for value in row) for row in rows)]
    for xyz, rgb in zip(points.tolist(), colours.tolist(), strict=True):
        lines += [" ".join(f"{value:.4f}" for value in xyz), " ".join(map(str, rgb)), "1 0 5 1.0 2.0"]
    (folder / "bundle.out").write_text("\n".join(lines) + "\n")
    (folder / "bundle.list.txt").write_text("".join(f"{one.image}\n" for one in component.cameras))


def metashape(folder: Path) -> None:
    ply_mesh(folder)
    cameras = []
    for k, one in enumerate(block(None).cameras):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = one.cam_from_world.rotation, one.cam_from_world.translation
        numbers = " ".join(f"{value:.6f}" for value in np.linalg.inv(pose).ravel())
        cameras.append(f'<camera id="{k}" sensor_id="0" label="{one.image}"><transform>{numbers}</transform></camera>')
    sensor = '<sensor id="0" type="frame"><resolution width="96" height="72"/><calibration class="adjusted">'
    sensor += '<resolution width="96" height="72"/><f>80</f><cx>0</cx><cy>0</cy><k1>0.01</k1></calibration></sensor>'
    place = (
        "<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>0 0 0</translation><scale>1</scale></transform>"
    )
    content = (
        f"<sensors>{sensor}</sensors><cameras>{''.join(cameras)}</cameras><reference>LOCAL_CS[]</reference>{place}"
    )
    (folder / "cameras.xml").write_text(f'<document version="2.0.0"><chunk>{content}</chunk></document>')


def realityscan(folder: Path) -> None:
    ply_mesh(folder)
    rows = [f"{k}.png,{10 + 3 * k}.0,15.0,40.0,0.0,0.0,0.0" for k in range(4)]
    (folder / "cameras.csv").write_text("\n".join(["#name,x,y,alt,heading,pitch,roll", *rows]) + "\n")


def odm(folder: Path) -> None:
    for name in ("odm_orthophoto", "odm_dem", "odm_georeferencing", "odm_texturing"):
        (folder / name).mkdir(parents=True)
    orthophoto(folder)
    (folder / "ortho.tif").rename(folder / "odm_orthophoto/odm_orthophoto.tif")
    (folder / "dsm.tif").rename(folder / "odm_dem/dsm.tif")
    _las(folder / "odm_georeferencing/odm_georeferenced_model.laz")
    (folder / "odm_georeferencing/coords.txt").write_text("WGS84 UTM 17N\n500000 2999980\n")
    obj(folder / "odm_texturing")
    (folder / "odm_texturing/m.obj").rename(folder / "odm_texturing/odm_textured_model_geo.obj")
