# SPDX-License-Identifier: Apache-2.0
"""Models that cannot be used end with one line that names the file and the remedy."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skymoor.engines.colmap import write_colmap
from skymoor.errors import InputError
from skymoor.models import read_model
from skymoor.models.colmap import open_colmap
from support.blocks import block
from support.given_models import write_las, write_ply, write_raster


def points(count: int = 2000) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(0, 40, count), rng.uniform(0, 30, count), rng.normal(0, 1, count)])


def with_nan(folder: Path) -> Path:
    xyz = points()
    xyz[5, 1] = np.nan
    return write_ply(folder / "m.ply", xyz)


def geocentric_floats(folder: Path) -> Path:
    return write_ply(folder / "m.ply", points() + [4_200_000.0, 600_000.0, 4_700_000.0])


def without_extent(folder: Path) -> Path:
    return write_ply(folder / "m.ply", np.zeros((2000, 3)))


def far_too_large(folder: Path) -> Path:
    return write_ply(folder / "m.ply", points() * 1e12, kind="f8")


def on_a_line(folder: Path) -> Path:
    return write_ply(folder / "m.ply", np.outer(np.arange(2000.0), [1.0, 2.0, 3.0]))


def too_few(folder: Path) -> Path:
    return write_las(folder / "m.las", points(20))


def cut_off(folder: Path) -> Path:
    whole = write_las(folder / "m.laz", points())
    whole.write_bytes(whole.read_bytes()[:500])
    return whole


def with_wrong_faces(folder: Path) -> Path:
    return write_ply(folder / "m.ply", points(), faces=[[0, 1, 99999]])


def without_texture(folder: Path) -> Path:
    (folder / "m.mtl").write_text("newmtl a\nmap_Kd wall.png\n")
    (folder / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return folder / "m.obj"


def without_materials(folder: Path) -> Path:
    (folder / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return folder / "m.obj"


def without_a_buffer(folder: Path) -> Path:
    content = {"asset": {"version": "2.0"}, "buffers": [{"uri": "data.bin", "byteLength": 4}]}
    (folder / "m.gltf").write_text(json.dumps(content))
    return folder / "m.gltf"


def draco(folder: Path) -> Path:
    content = {"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    (folder / "m.gltf").write_text(json.dumps(content))
    return folder / "m.gltf"


def json_in_a_folder(name: str, text: str | bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / "m").mkdir()
        (folder / "m" / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        return folder / "m"

    return make


def transforms(**wrong: object) -> Callable[[Path], Path]:
    frame = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist(), "w": 100, "h": 80, "fl_x": 90}
    return json_in_a_folder("transforms.json", json.dumps({"frames": [{**frame, **wrong}]}))


def mesh_gltf(**wrong: object) -> Callable[[Path], Path]:
    """Of which one thing is wrong; without it, a mesh of two triangles whose faces name vertices that are not there."""

    def make(folder: Path) -> Path:
        body = points(600).astype("<f4").tobytes() + np.array([0, 1, 2, 0, 1, 60_000], "<u4").tobytes()
        (folder / "m.bin").write_bytes(body)
        views = [{"buffer": 0, "byteLength": 7200}, {"buffer": 0, "byteOffset": 7200, "byteLength": 24}]
        content = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 600, "type": "VEC3"},
                {"bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR"},
            ],
            "bufferViews": views,
            "buffers": [{"byteLength": len(body), "uri": "m.bin"}],
        }
        (folder / "m.gltf").write_text(json.dumps({**content, **wrong}))
        return folder / "m.gltf"

    return make


def billions_of_records(folder: Path) -> Path:
    path = write_las(folder / "m.las", points())
    content = bytearray(path.read_bytes())
    content[100:104] = b"\xff" * 4
    path.write_bytes(content)
    return path


def billions_of_chunks(folder: Path) -> Path:
    path = write_las(folder / "m.laz", points())
    content = bytearray(path.read_bytes())
    (table,) = struct.unpack_from("<q", content, struct.unpack_from("<I", content, 96)[0])
    struct.pack_into("<I", content, table + 4, 2**31)
    path.write_bytes(content)
    return path


def degenerate_pose(folder: Path) -> Path:
    write_ply(folder / "m.ply", points())
    sensor = '<sensor id="0"><calibration><resolution width="90" height="70"/><f>80</f></calibration></sensor>'
    chunk = "<transform><rotation>1 0 0 0 1 0 0 0 0</rotation><scale>1</scale></transform>"
    camera = '<camera id="0" sensor_id="0" label="a"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>'
    body = f"<sensors>{sensor}</sensors><cameras>{camera}</cameras><reference>LOCAL_CS[]</reference>{chunk}"
    (folder / "m.xml").write_text(f'<document version="2.0"><chunk>{body}</chunk></document>')
    return folder


def no_end_of_zeros(folder: Path) -> Path:
    """A splat of a hundred million points that holds 64 MB of zeros, many times over."""
    zeros = gzip.compress(bytes(1 << 26), 1)
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, 2**31, 0, 12, 0, 0)
    (folder / "m.spz").write_bytes(gzip.compress(head) + zeros * 40)
    return folder / "m.spz"


def splat_without_colours(folder: Path) -> Path:
    names = [*"xyz", "f_dc_0", "opacity", "scale_0", "rot_0"]
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 2000",
        *(f"property float {one}" for one in names),
    ]
    rows = np.column_stack([points(), np.ones((2000, 4))]).astype("<f4")
    (folder / "m.ply").write_bytes("\n".join([*head, "end_header\n"]).encode() + rows.tobytes())
    return folder / "m.ply"


def bundle_with_a_list_of_nothing(folder: Path) -> Path:
    camera = "1 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n"
    rows = "".join(f"{x} {y} {z}\n9 9 9\n0\n" for x, y, z in points(200))
    (folder / "m.out").write_text(f"# Bundle file v0.3\n1 200\n{camera}{rows}")
    (folder / "m.list.txt").write_bytes(b"\xff\xfe\x00")
    return folder / "m.out"


def damaged_e57(folder: Path) -> Path:
    (folder / "m.e57").write_bytes(b"ASTM-E57" + bytes(200))
    return folder / "m.e57"


def of_no_kind(folder: Path) -> Path:
    (folder / "m.fbx").write_bytes(b"Kaydara FBX Binary")
    return folder / "m.fbx"


def empty_folder(folder: Path) -> Path:
    (folder / "m").mkdir()
    return folder / "m"


def damaged_colmap(folder: Path) -> Path:
    (folder / "m").mkdir()
    for name in ("cameras", "images", "points3D"):
        (folder / "m" / f"{name}.bin").write_bytes(b"\1\0\0\0\0\0\0\0\1")
    return folder / "m"


def transforms_without_a_cloud(folder: Path) -> Path:
    frame = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist(), "w": 100, "h": 80, "fl_x": 90}
    (folder / "transforms.json").write_text(json.dumps({"frames": [frame] * 3}))
    return folder / "transforms.json"


def damaged_json(folder: Path) -> Path:
    (folder / "transforms.json").write_text("{")
    return folder / "transforms.json"


def metashape_alone(folder: Path) -> Path:
    (folder / "m.xml").write_text('<document version="2.0"><chunk><cameras/></chunk></document>')
    return folder / "m.xml"


def empty_orthophoto(folder: Path) -> Path:
    return write_raster(folder / "m.tif", np.zeros((3, 50, 50), np.uint8))


def tiny_orthophoto(folder: Path) -> Path:
    return write_raster(folder / "m.tif", np.full((3, 10, 50), 90, np.uint8))


def not_there(folder: Path) -> Path:
    return folder / "m.laz"


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (with_nan, "NaN"),
        (geocentric_floats, "32-bit"),
        (without_extent, "no scale of sense"),
        (far_too_large, "no scale of sense"),
        (on_a_line, "one line"),
        (too_few, "at least 500"),
        (cut_off, "LAS"),
        (with_wrong_faces, "faces"),
        (without_texture, "wall.png is missing"),
        (without_materials, "materials"),
        (without_a_buffer, "data.bin is missing"),
        (draco, "compressed"),
        (json_in_a_folder("reconstruction.json", "["), "JSON"),
        (json_in_a_folder("reconstruction.json", b"\xff"), "JSON"),
        (json_in_a_folder("reconstruction.json", "[" * 100_000), "JSON"),
        (json_in_a_folder("reconstruction.json", "[]"), "OpenSfM"),
        (json_in_a_folder("reconstruction.json", "[[1]]"), "OpenSfM"),
        (json_in_a_folder("transforms.json", "{"), "JSON"),
        (transforms(w=float("inf")), "nerfstudio"),
        (transforms(fl_x=10**400), "nerfstudio"),
        (mesh_gltf(), "vertices that are not there"),
        (mesh_gltf(extensionsRequired=None), "gltf"),
        (mesh_gltf(meshes=[{"primitives": [None]}]), "gltf"),
        (mesh_gltf(buffers=[{"uri": True}]), "gltf"),
        (billions_of_records, "records in its header"),
        (billions_of_chunks, "records in its header"),
        (degenerate_pose, "m.xml: is no file of Metashape"),
        (no_end_of_zeros, "version"),
        (splat_without_colours, "ply"),
        (bundle_with_a_list_of_nothing, "list of Bundler"),
        (damaged_e57, "E57"),
        (of_no_kind, "export it as GLB"),
        (empty_folder, "has no model"),
        (damaged_colmap, "COLMAP"),
        (transforms_without_a_cloud, "ply_file_path"),
        (damaged_json, "JSON"),
        (metashape_alone, "mesh or cloud"),
        (empty_orthophoto, "no data"),
        (tiny_orthophoto, "only 50 by 10"),
        (not_there, "no such file"),
    ],
)
def test_one_line_names_the_file_and_the_remedy(make: Callable[[Path], Path], says: str, tmp_path: Path) -> None:
    path = make(tmp_path)
    with pytest.raises(InputError) as error:
        read_model([path])
    line = str(error.value)
    assert says in line and "\n" not in line
    assert path.stem in line and (";" in line or "no such" in line)


def test_two_sets_of_cameras_are_no_model(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for file in ("cameras", "images", "points3D"):
            (tmp_path / name / f"{file}.txt").write_text("")
    with pytest.raises(InputError, match="one model at a time"):
        read_model([tmp_path / "a", tmp_path / "b"])


@pytest.mark.parametrize(
    ("name", "at", "kind"),
    [
        ("cameras", 0, "<Q"),
        ("images", 0, "<Q"),
        ("points3D", 8 + 43, "<Q"),
        ("frames", 8 + 64, "<I"),
        ("rigs", 8 + 4, "<I"),
    ],
)
def test_colmap_is_not_let_loose_on_claims_without_end(name: str, at: int, kind: str, tmp_path: Path) -> None:
    component = block("oblique", relief_m=3.0)
    write_colmap(component, tmp_path)
    assert len(open_colmap(tmp_path).images) == len(component.cameras)
    path = tmp_path / f"{name}.bin"
    content = bytearray(path.read_bytes())
    struct.pack_into(kind, content, at, 2**31)
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"{name}\.bin: is cut off"):
        open_colmap(tmp_path)


def test_colmap_does_not_go_along_the_border_of_an_image_without_end(tmp_path: Path) -> None:
    write_colmap(block("oblique", relief_m=3.0), tmp_path)
    content = bytearray((tmp_path / "cameras.bin").read_bytes())
    struct.pack_into("<Q", content, 16, 2**33)
    (tmp_path / "cameras.bin").write_bytes(content)
    with pytest.raises(InputError, match=r"8589934592 by \d+ pixels; export the model again"):
        read_model([tmp_path])
