# SPDX-License-Identifier: Apache-2.0
"""Files are rewritten by a known similarity, and hold all else as it was."""

from __future__ import annotations

import json
import struct
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import plyfile
import pytest
import rasterio
import trimesh
from numpy.typing import NDArray
from PIL import Image
from rasterio import Affine
from scipy.spatial.transform import Rotation

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity
from skymoor.models import read_model
from skymoor.models.bundler import parsed
from skymoor.models.given import Part
from skymoor.models.realityscan import rotation_of, table_of
from skymoor.results.formats._crs import MapFrame
from skymoor.results.formats.gltf import ecef_from_enu
from skymoor.results.placed.move import MOVERS, move_part
from skymoor.results.placed.placement import Placement
from skymoor.results.placed.ply import turned_harmonics
from support.given_models import write_las, write_ply, write_raster

Array = NDArray[np.float64]

FRAME = EnuFrame(46.9, 7.4, 560.0)
MOVE = Similarity(7.5, Rotation.from_euler("zyx", [130, 3, -2], degrees=True).as_matrix(), np.array([30.0, -20, 5]))
FLAT = Similarity(7.5, Rotation.from_euler("z", 130, degrees=True).as_matrix(), np.array([30.0, -20, 5]))


@pytest.fixture
def there() -> Placement:
    return Placement.on(MOVE, FRAME, "EPSG:32632", "CONFIRMED", 0.0)


def points(count: int = 600) -> Array:
    return np.random.default_rng(4).uniform([-9, -8, 0], [9, 8, 2], (count, 3))


def move(path: Path, there: Placement, folder: Path, kind: str) -> list[str]:
    folder.mkdir()
    return MOVERS[kind](path, folder, there)  # type: ignore[index]


def test_a_cloud_keeps_all_that_its_points_carry(there: Placement, tmp_path: Path) -> None:
    xyz = points()
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = np.full(3, 1e-5)
    header.add_extra_dim(laspy.ExtraBytesParams("planarity", "f4"))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.intensity, cloud.classification = np.arange(600), np.arange(600) % 9
    cloud.scan_angle_rank, cloud.gps_time = np.full(600, -6), np.arange(600.0)
    cloud.red, cloud.planarity = np.arange(600) * 100, np.linspace(0, 1, 600)
    cloud.write(tmp_path / "a.las")
    move(tmp_path / "a.las", there, tmp_path / "out", "las")
    found = laspy.read(tmp_path / "out" / "a.laz")
    assert np.abs(np.asarray(found.xyz) - there.map(xyz)).max() < 0.001
    assert found.header.parse_crs().to_2d().to_epsg() == 32632
    for name in ("intensity", "classification", "gps_time", "red", "planarity"):
        assert (np.asarray(found[name]) == np.asarray(cloud[name])).all()
    assert np.abs(np.asarray(found.scan_angle) * 0.006 + 6).max() < 0.01


def test_degrees_give_way_to_the_utm_zone() -> None:
    assert Placement.on(MOVE, FRAME, "EPSG:4326", None, 0.0).crs == "EPSG:32632"
    assert Placement.on(MOVE, EnuFrame(-33.0, 151.0, 0.0), "EPSG:4326", None, 0.0).crs == "EPSG:32756"


def test_a_mesh_as_ply(there: Placement, tmp_path: Path) -> None:
    xyz = points()
    write_ply(tmp_path / "a.ply", xyz, faces=[[0, 1, 2], [2, 3, 4]], kind="f8")
    move(tmp_path / "a.ply", there, tmp_path / "out", "ply")
    file = plyfile.PlyData.read(str(tmp_path / "out" / "a.ply"))
    assert np.abs(np.column_stack([file["vertex"][a] for a in "xyz"]) - MOVE.apply(xyz)).max() < 1e-9
    assert [list(one) for one in file["face"]["vertex_indices"]] == [[0, 1, 2], [2, 3, 4]]
    assert any("46.9" in line for line in file.comments)


def colour_towards(coefficients: Array, directions: Array) -> Array:
    """Harmonics of degree 1 and one of degree 2, written out: the terms of -y, z, -x, and of xy."""
    x, y, z = directions.T
    one = 0.4886025119029199 * np.column_stack([-y, z, -x]) @ coefficients[:3]
    return np.asarray(one + 1.0925484305920792 * x * y * coefficients[3])


def test_a_splat_looks_the_same_from_everywhere(there: Placement, tmp_path: Path) -> None:
    names = [*"xyz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(24))]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    rng = np.random.default_rng(1)
    vertex = np.zeros(700, [(name, "<f4") for name in names])
    vertex["x"], vertex["y"], vertex["z"] = points(700).T
    vertex["opacity"] = 3.0
    for k in range(3):
        vertex[f"scale_{k}"] = rng.normal(-3, 0.5, 700)
    turns = Rotation.random(700, random_state=3)
    for k, column in enumerate(turns.as_quat(scalar_first=True).T):
        vertex[f"rot_{k}"] = column
    for k in range(4):
        vertex[f"f_rest_{k}"] = rng.normal(0, 0.3, 700)  # of red: three of degree 1, and the first of degree 2
    plyfile.PlyData([plyfile.PlyElement.describe(vertex, "vertex")]).write(str(tmp_path / "a.ply"))
    move(tmp_path / "a.ply", there, tmp_path / "out", "ply")
    found = plyfile.PlyData.read(str(tmp_path / "out" / "a.ply"))["vertex"]
    quaternions = np.column_stack([found[f"rot_{k}"] for k in range(4)])
    shape = [
        turn.as_matrix() * np.exp(np.column_stack([source[f"scale_{k}"] for k in range(3)]))[:, None, :]
        for turn, source in ((turns, vertex), (Rotation.from_quat(quaternions, scalar_first=True), found))
    ]
    assert np.abs(MOVE.scale * MOVE.rotation @ shape[0] - shape[1]).max() < 1e-4
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = np.array([vertex[f"f_rest_{k}"][7] for k in range(4)], np.float64)
    rest = np.array([[[found[f"f_rest_{8 * c + k}"][7] for k in range(8)] for c in range(3)]], np.float64)
    back = turned_harmonics(rest, MOVE.rotation.T)[0, 0]
    assert np.abs(back[:4] - before).max() < 1e-5 and np.abs(back[4:]).max() < 1e-5
    degree_1 = np.append(before[:3], 0.0)
    turned = np.append(rest[0, 0, :3], 0.0)
    seen = colour_towards(turned, directions @ MOVE.rotation.T), colour_towards(degree_1, directions)
    assert np.abs(seen[0] - seen[1]).max() < 1e-5 < np.abs(seen[1]).max()


def test_a_textured_obj_keeps_its_materials(there: Placement, tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "textures" / "wall.png")
    (tmp_path / "a.mtl").write_text("newmtl wall\nmap_Kd textures/wall.png\n")
    text = "mtllib a.mtl\nv 1 2 3 0.5 0.5 0.5\nv 2 2 3\nv 1 5 3\nvn 0 0 1\nvt 0 0\nusemtl wall\nf 1/1/1 2/1/1 3/1/1\n"
    (tmp_path / "a.obj").write_text(text)
    move(tmp_path / "a.obj", there, tmp_path / "out", "obj")
    lines = (tmp_path / "out" / "a.obj").read_text().splitlines()
    first = next(line.split() for line in lines if line.startswith("v "))
    assert np.abs(np.array(first[1:4], float) - MOVE.apply([1.0, 2.0, 3.0])).max() < 1e-6 and first[4:] == ["0.5"] * 3
    normal = next(line.split() for line in lines if line.startswith("vn "))
    assert np.abs(np.array(normal[1:], float) - MOVE.rotation[:, 2]).max() < 1e-6
    assert "f 1/1/1 2/1/1 3/1/1" in lines and (tmp_path / "out" / "textures" / "wall.png").is_file()


def test_a_glb_below_a_new_root(there: Placement, tmp_path: Path) -> None:
    mesh = trimesh.creation.box((4, 6, 2))
    mesh.apply_translation([1, 2, 3])
    mesh.export(str(tmp_path / "a.glb"))
    move(tmp_path / "a.glb", there, tmp_path / "out", "gltf")
    moved = trimesh.load_scene(str(tmp_path / "out" / "a.glb")).to_mesh()
    enu = MOVE.apply(mesh.vertices)
    yup = np.column_stack([enu[:, 0], enu[:, 2], -enu[:, 1]])
    order = [np.lexsort(np.round(one, 3).T) for one in (moved.vertices, yup)]
    assert np.abs(moved.vertices[order[0]] - yup[order[1]]).max() < 1e-3
    content = (tmp_path / "out" / "a.glb").read_bytes()
    assert struct.unpack_from("<I", content, 8)[0] == len(content)


def test_an_orthophoto_and_its_dsm_keep_their_pixels(tmp_path: Path) -> None:
    there = Placement.on(FLAT, FRAME, "EPSG:32632", "CONFIRMED", 1.5)
    rng = np.random.default_rng(6)
    pixels, heights = rng.integers(1, 255, (3, 40, 50), np.uint8), rng.normal(1.5, 0.5, (40, 50)).astype(np.float32)
    heights[3, 4] = -9999
    own = Affine.translation(-9, 8) @ Affine.scale(0.2, -0.2)
    write_raster(tmp_path / "o.tif", pixels, own)
    write_raster(tmp_path / "d.tif", heights[None], own, nodata=-9999)
    move(tmp_path / "o.tif", there, tmp_path / "out", "orthophoto")
    MOVERS["dsm"](tmp_path / "d.tif", tmp_path / "out", there)
    with rasterio.open(tmp_path / "out" / "o.tif") as ortho, rasterio.open(tmp_path / "out" / "d.tif") as dsm:
        assert (ortho.read() == pixels).all()
        assert ortho.transform.almost_equals(dsm.transform, 1e-6)
        chart, found = MapFrame(FRAME, ortho.crs.to_wkt()), dsm.read(1)
        u, v = np.array([0.5, 10.5, 49.5]), np.array([0.5, 30.5, 20.5])
        rows, columns = v.astype(int), u.astype(int)
        model = np.column_stack([*(own @ (u, v)), heights[rows, columns]])
        on_map = chart.map_from_enu(FLAT.apply(model))
        assert np.abs(np.column_stack(ortho.transform @ (u, v)) - on_map[:, :2]).max() < 0.1 * 0.2 * 7.5
        assert np.abs(found[rows, columns] - on_map[:, 2]).max() < 0.002
        assert found[3, 4] == -9999 and dsm.nodata == -9999


def test_a_dsm_without_a_geotransform_is_not_moved(there: Placement, tmp_path: Path) -> None:
    path = write_raster(tmp_path / "d.tif", np.ones((1, 40, 50), np.float32))
    (note,) = move(path, there, tmp_path / "out", "dsm")
    assert "no geotransform" in note and not list((tmp_path / "out").iterdir())


def gl_pose(seed: int) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    pose[:3, 3] = [seed, 2, 3]
    return pose


def test_transforms_of_nerfstudio(there: Placement, tmp_path: Path) -> None:
    frames = [{"file_path": "a.jpg", "transform_matrix": gl_pose(k).tolist()} for k in range(3)]
    content = {"frames": frames, "applied_transform": np.eye(4)[:3].tolist(), "fl_x": 500}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    move(tmp_path / "transforms.json", there, tmp_path / "out", "nerfstudio")
    found = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert found["fl_x"] == 500 and "applied_transform" not in found and found["enu_origin"]["lat"] == 46.9
    for k, frame in enumerate(found["frames"]):
        pose = np.array(frame["transform_matrix"])
        assert np.abs(pose[:3, 3] - MOVE.apply([k, 2.0, 3.0])).max() < 1e-9
        assert np.abs(pose[:3, :3] - MOVE.rotation @ gl_pose(k)[:3, :3]).max() < 1e-9


def test_shots_of_opensfm(there: Placement, tmp_path: Path) -> None:
    turn = Rotation.random(random_state=5)
    centre = np.array([1.0, 2, 30])
    shot = {"rotation": turn.as_rotvec().tolist(), "translation": (-turn.as_matrix() @ centre).tolist(), "camera": "a"}
    content = [{"shots": {"x.jpg": shot}, "points": {"1": {"coordinates": [4, 5, 6]}}, "cameras": {}}]
    (tmp_path / "reconstruction.json").write_text(json.dumps(content))
    move(tmp_path / "reconstruction.json", there, tmp_path / "out", "opensfm")
    (found,) = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    moved = found["shots"]["x.jpg"]
    rotation = Rotation.from_rotvec(moved["rotation"]).as_matrix()
    assert np.abs(-rotation.T @ np.array(moved["translation"]) - MOVE.apply(centre)).max() < 1e-6
    assert np.abs(rotation @ MOVE.rotation - turn.as_matrix()).max() < 1e-9
    assert np.abs(np.array(found["points"]["1"]["coordinates"]) - MOVE.apply([4.0, 5, 6])).max() < 1e-9
    assert found["reference_lla"] == {"latitude": 46.9, "longitude": 7.4, "altitude": 560.0}


def test_a_bundle(there: Placement, tmp_path: Path) -> None:
    turn, centre = Rotation.random(random_state=8).as_matrix(), np.array([1.0, 2, 30])
    lines = ["# Bundle file v0.3", "2 1", "500 0 0", *(" ".join(map(repr, row)) for row in turn.tolist())]
    lines += [
        " ".join(map(repr, (-turn @ centre).tolist())),
        "0 0 0",
        *["0 0 0"] * 4,
        "4 5 6",
        "1 2 3",
        "1 0 7 0.5 0.5",
    ]
    (tmp_path / "b.out").write_text("\n".join(lines) + "\n")
    move(tmp_path / "b.out", there, tmp_path / "out", "bundler")
    cameras, found, _ = parsed(tmp_path / "out" / "b.out")
    assert np.abs(-cameras[0, 1:4].T @ cameras[0, 4] - MOVE.apply(centre)).max() < 1e-9
    assert (cameras[1] == 0).all() and np.abs(found - MOVE.apply([[4.0, 5, 6]])).max() < 1e-9
    assert (tmp_path / "out" / "b.out").read_text().splitlines()[-1] == "1 0 7 0.5 0.5"


def test_the_chunk_of_metashape(there: Placement, tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text('<document><chunk label="a"><cameras/></chunk></document>')
    move(tmp_path / "m.xml", there, tmp_path / "out", "metashape")
    chunk = ET.parse(tmp_path / "out" / "m.xml").find("chunk")
    assert chunk is not None and chunk.get("label") == "a"
    numbers = {
        name: np.array((chunk.findtext(f"transform/{name}") or "").split(), float)
        for name in ("rotation", "translation", "scale")
    }
    ecef = numbers["scale"] * numbers["rotation"].reshape(3, 3) @ [1.0, 2, 3] + numbers["translation"]
    expected = ecef_from_enu(FRAME) @ [*MOVE.apply([1.0, 2, 3]), 1.0]
    assert np.abs(ecef - expected[:3]).max() < 1e-6
    assert (chunk.findtext("reference") or "").startswith("GEOGCS")


def test_cameras_of_realityscan(there: Placement, tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("#name,x,y,alt,heading,pitch,roll,f\na.jpg,1,2,3,20,10,5,35\n")
    move(tmp_path / "r.csv", there, tmp_path / "out", "realityscan")
    names, (row,) = table_of(tmp_path / "out" / "r.csv")
    assert names[0] == "#name" and row["f"] == "35"
    at = np.array([float(row[name]) for name in ("x", "y", "alt")])
    assert np.abs(at - there.map([[1.0, 2, 3]])[0]).max() < 1e-3
    _, (before,) = table_of(tmp_path / "r.csv")
    turned, own = rotation_of(row), rotation_of(before)
    assert turned is not None and own is not None and np.abs(turned - MOVE.rotation @ own).max() < 1e-6


def test_what_was_not_needed_to_render_it_is_told_too(there: Placement, tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text("#name,x,y,alt,heading,pitch,roll\na.jpg,1,2,3,north,0,0\n")
    with pytest.raises(InputError, match=r"c\.csv: cannot be moved"):
        move_part(Part("realityscan", tmp_path / "c.csv"), tmp_path, there)


def test_an_offset_is_added_first(there: Placement) -> None:
    moved = there.offset_by((100.0, 200.0, 0.0))
    assert np.abs(moved.enu([[1.0, 2, 3]]) - there.enu([[101.0, 202, 3]])).max() < 1e-9


def test_every_kind_that_is_read_is_moved(tmp_path: Path) -> None:
    model = read_model([write_las(tmp_path / "a.las", points())])
    assert replace(model).parts[0].kind in MOVERS and len(MOVERS) == 14
