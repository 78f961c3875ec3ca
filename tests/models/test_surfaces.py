# SPDX-License-Identifier: Apache-2.0
"""Clouds, meshes, splats and orthophotos are read as their files have them, and rendered from above."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path

import numpy as np
import plyfile
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image
from rasterio import Affine
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity
from skymoor.model.views import RenderOptions
from skymoor.models import Cloud, Mesh, Plan, read_model
from skymoor.models.render import found_up, level_of, mirrored, render_given
from skymoor.models.spz import splat_of_spz
from support.given_models import write_las, write_ply, write_raster

Array = NDArray[np.float64]


def landscape(rng: np.random.Generator, count: int = 40_000) -> tuple[Array, NDArray[np.uint8]]:
    """Level ground of 40 by 30 m, red in the west and green in the east, with a blue house 6 m high."""
    xyz = np.column_stack([rng.uniform(0, 40, count), rng.uniform(0, 30, count), rng.normal(0, 0.02, count)])
    rgb = np.where(xyz[:, :1] < 20, [[200, 30, 30]], [[30, 200, 30]]).astype(np.uint8)
    house = (np.abs(xyz[:, 0] - 30) < 5) & (np.abs(xyz[:, 1] - 20) < 4)
    xyz[house, 2] += 6
    rgb[house] = [30, 30, 200]
    return xyz, rgb


@pytest.fixture
def place(rng: np.random.Generator) -> tuple[Array, NDArray[np.uint8]]:
    return landscape(rng)


@pytest.mark.parametrize("kind", ["las", "ply", "e57"])
def test_a_cloud_has_its_points_and_colours(kind: str, place: tuple[Array, NDArray[np.uint8]], tmp_path: Path) -> None:
    xyz, rgb = place
    path = tmp_path / f"cloud.{kind}"
    if kind == "las":
        write_las(path, xyz, rgb)
    elif kind == "ply":
        write_ply(path, xyz, rgb)
    else:
        import pye57

        data = {f"cartesian{axis}": column for axis, column in zip("XYZ", xyz.T, strict=True)}
        data |= {f"color{name}": column for name, column in zip(("Red", "Green", "Blue"), rgb.T, strict=True)}
        with pye57.E57(str(path), mode="w") as file:
            file.write_scan_raw(data)
    model = read_model([path])
    assert isinstance(model.surface, Cloud) and model.surface.colours is not None
    assert np.abs(model.surface.points - xyz).max() < 1e-3
    assert (model.surface.colours == rgb).all()
    assert (model.up is None) == (kind == "ply")
    assert model.unit_m == (1.0 if kind == "e57" else None)


def test_a_cloud_from_above(place: tuple[Array, NDArray[np.uint8]], rng: np.random.Generator) -> None:
    cloud = Cloud(*place)
    level, sigma_deg = level_of(cloud, np.array([0.0, 0.0, 1.0]), rng)
    render = render_given(cloud, level, RenderOptions())
    assert sigma_deg == 1.0 and level.scale == 1.0
    points = level.inverse().apply(render.xyz[np.isfinite(render.xyz[..., 2])].astype(np.float64))
    assert abs(np.ptp(points[:, 0]) - 40) < 1 and abs(np.ptp(points[:, 1]) - 30) < 1
    where = level.apply([[30.0, 20.0, 6.0], [5.0, 5.0, 0.0], [35.0, 5.0, 0.0]])
    v = ((-where[:, 1] - render.view.y0) / render.view.pixel).astype(int)
    u = ((where[:, 0] - render.view.x0) / render.view.pixel).astype(int)
    assert np.abs(render.xyz[v, u, 2] - where[:, 2]).max() < 0.1
    assert render.rgb[v, u].argmax(axis=1).tolist() == [2, 0, 1]
    other = mirrored(render)
    assert (other.rgb[:, ::-1] == render.rgb).all()
    known = np.isfinite(other.xyz[..., 0])
    across = render.view.x0 + (np.arange(known.shape[1]) + 0.5) * render.view.pixel
    assert np.abs((other.xyz[..., 0] - across)[known]).max() < 1e-3


def test_up_is_found_on_the_side_of_the_houses(
    place: tuple[Array, NDArray[np.uint8]], rng: np.random.Generator
) -> None:
    for seed in range(5):
        turn = Rotation.random(random_state=seed).as_matrix()
        up = found_up(place[0] @ turn.T * 3 + [1, 2, 3], rng)
        assert np.degrees(np.arccos(np.clip(up @ turn[:, 2], -1, 1))) < 1.0


def test_colourless_heights_are_shaded(place: tuple[Array, NDArray[np.uint8]]) -> None:
    render = render_given(Cloud(place[0], None), Similarity.identity(), RenderOptions())
    assert (render.rgb[..., 0] == render.rgb[..., 2]).all() and render.rgb.std() > 1


def textured(folder: Path) -> trimesh.Trimesh:
    """A sloping rectangle of many triangles with a texture whose left half is red, right half green."""
    u, v = np.meshgrid(np.linspace(0, 1, 30), np.linspace(0, 1, 30))
    vertices = np.column_stack([40 * u.ravel(), 30 * v.ravel(), 2 * u.ravel()])
    corner = np.arange(900).reshape(30, 30)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:, :32, 0], pixels[:, 32:, 1] = 220, 220
    pixels[:32, :, 2] = 180  # the upper half of the image, which is far along v
    material = trimesh.visual.material.SimpleMaterial(image=Image.fromarray(pixels))
    visual = trimesh.visual.TextureVisuals(uv=np.column_stack([u.ravel(), v.ravel()]), material=material)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)


@pytest.mark.parametrize("name", ["mesh.obj", "mesh.glb"])
def test_a_textured_mesh_from_above(name: str, tmp_path: Path, rng: np.random.Generator) -> None:
    mesh = textured(tmp_path)
    if name.endswith("glb"):
        mesh.apply_transform(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))  # y up
    mesh.export(str(tmp_path / name))
    model = read_model([tmp_path / name])
    assert isinstance(model.surface, Mesh) and len(model.surface.textures) == 1
    level, _ = level_of(model.surface, model.up, rng)
    render = render_given(model.surface, level, RenderOptions(max_px=200))
    rows, columns = render.view.shape
    assert 0.7 < rows / columns < 0.8
    assert render.confidence.mean() > 0.95
    middle = render.rgb[rows // 4, [columns // 4, 3 * columns // 4]], render.rgb[3 * rows // 4, [columns // 4]]
    if model.up is not None:  # else north is on any side
        assert middle[0][0, 0] > 200 and middle[0][1, 1] > 200 and middle[0][0, 2] > 150 and middle[1][0, 2] < 50
        assert abs(np.nanmax(render.xyz[..., 2]) - np.nanmin(render.xyz[..., 2]) - 2) < 0.2


def splat(xyz: Array, rgb: NDArray[np.uint8], degree: int = 1) -> NDArray[np.void]:
    names = [*"xyz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(9 * degree))]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    vertex = np.zeros(len(xyz), [(name, "<f4") for name in names])
    vertex["x"], vertex["y"], vertex["z"] = xyz.T
    for k in range(3):
        vertex[f"f_dc_{k}"] = (rgb[:, k] / 255 - 0.5) / 0.28209479177387814
    vertex["opacity"], vertex["rot_0"] = 4.0, 1.0
    vertex["opacity"][::50] = -8.0
    return vertex


def test_a_splat_shows_its_opaque_centres(place: tuple[Array, NDArray[np.uint8]], tmp_path: Path) -> None:
    xyz, rgb = place
    path = tmp_path / "splat.ply"
    plyfile.PlyData([plyfile.PlyElement.describe(splat(xyz, rgb), "vertex")]).write(str(path))
    cloud = read_model([path]).surface
    assert isinstance(cloud, Cloud) and cloud.colours is not None
    opaque = np.arange(len(xyz)) % 50 != 0
    assert len(cloud.points) == opaque.sum()
    assert np.abs(cloud.colours.astype(int) - rgb[opaque]).max() <= 1


def test_a_packed_splat(rng: np.random.Generator, tmp_path: Path) -> None:
    xyz, rgb = landscape(rng, 2000)
    fixed = np.rint(xyz * 4096).astype(np.int32)
    packed = np.stack([fixed & 255, fixed >> 8 & 255, fixed >> 16 & 255], axis=-1).astype(np.uint8)
    colours = np.clip(np.rint(((rgb / 255 - 0.5) / 0.28209479177387814 * 0.15 + 0.5) * 255), 0, 255).astype(np.uint8)
    turns = Rotation.random(2000, random_state=1).as_quat()
    turns *= np.sign(turns[:, 3:])
    data = struct.pack("<IIIBBBB", 0x5053474E, 2, 2000, 0, 12, 0, 0) + packed.tobytes()
    data += np.full(2000, 250, np.uint8).tobytes() + colours.tobytes() + np.full((2000, 3), 128, np.uint8).tobytes()
    data += np.rint((turns[:, :3] + 1) * 127.5).astype(np.uint8).tobytes()
    (tmp_path / "s.spz").write_bytes(gzip.compress(data))
    vertex = splat_of_spz(tmp_path / "s.spz")
    assert np.abs(np.column_stack([vertex[a] for a in "xyz"]) - xyz).max() < 1 / 4096
    assert np.abs(vertex["scale_1"] + 2).max() < 1e-6
    found = np.column_stack([vertex[f"rot_{k}"] for k in (1, 2, 3, 0)])
    assert 1e-4 < np.abs(found - turns).max() < 0.1
    assert isinstance(read_model([tmp_path / "s.spz"]).surface, Cloud)


def test_smallest_three_quaternions(rng: np.random.Generator, tmp_path: Path) -> None:
    xyz, _ = landscape(rng, 1000)
    turns = Rotation.random(1000, random_state=2).as_quat()
    words = []
    for one in turns:
        k = int(np.abs(one).argmax())
        word, one = k, one * np.sign(one[k])
        for j in range(4):
            if j != k:
                word = word << 10 | int(one[j] < 0) << 9 | round(abs(one[j]) / np.sqrt(0.5) * 511)
        words.append(word)
    fixed = np.rint(xyz * 4096).astype(np.int32)
    packed = np.stack([fixed & 255, fixed >> 8 & 255, fixed >> 16 & 255], axis=-1).astype(np.uint8)
    data = struct.pack("<IIIBBBB", 0x5053474E, 3, 1000, 0, 12, 0, 0) + packed.tobytes() + bytes([250]) * 1000
    data += bytes([128]) * 6000 + np.array(words, "<u4").tobytes()
    (tmp_path / "s.spz").write_bytes(gzip.compress(data))
    vertex = splat_of_spz(tmp_path / "s.spz")
    found = np.column_stack([vertex[f"rot_{k}"] for k in (1, 2, 3, 0)])
    assert np.abs(np.abs((found * turns).sum(axis=1)) - 1).max() < 1e-3


def test_an_orthophoto_in_its_own_coordinates(tmp_path: Path, rng: np.random.Generator) -> None:
    pixels = rng.integers(1, 255, (3, 60, 80), np.uint8)
    heights = np.tile(np.arange(80, dtype=np.float32), (60, 1))
    turned = Affine.translation(500, 900) @ Affine.rotation(30) @ Affine.scale(0.2, -0.2)
    ortho = write_raster(tmp_path / "o.tif", pixels, turned, "EPSG:32632")
    dsm = write_raster(tmp_path / "d.tif", heights[None], turned, "EPSG:32632")
    model = read_model([ortho, dsm])
    plan = model.surface
    assert isinstance(plan, Plan) and plan.heights is not None and model.unit_m == 1.0
    assert [part.kind for part in model.parts] == ["orthophoto", "dsm"]
    assert np.allclose(plan.model_from_px @ [0, 0, 1], [500, 900])
    level, _ = level_of(plan, model.up, rng)
    render = render_given(plan, level, RenderOptions())
    centre = plan.model_from_px @ [10.5, 20.5, 1.0]
    at = level.inverse().apply(render.xyz[20, 10].astype(np.float64))
    assert np.abs(at[:2] - centre).max() < 1e-3 and abs(at[2] - 10) < 0.6


def test_rows_that_go_north_are_no_mirror_image(tmp_path: Path, rng: np.random.Generator) -> None:
    pixels = rng.integers(1, 255, (3, 60, 80), np.uint8)
    up = write_raster(tmp_path / "o.tif", pixels, Affine.translation(5, 9) @ Affine.scale(0.2, 0.2), "EPSG:32632")
    plan = read_model([up]).surface
    assert isinstance(plan, Plan)
    assert (plan.rgb[0] == pixels[:, -1].T).all()
    assert np.allclose(plan.model_from_px @ [0, 0, 1], [5, 9 + 12])


def test_degrees_become_metres(tmp_path: Path, rng: np.random.Generator) -> None:
    pixels = rng.integers(1, 255, (3, 60, 80), np.uint8)
    size = 1e-5
    transform = Affine.translation(7.0, 60.0) @ Affine.scale(size, -size)
    plan = read_model([write_raster(tmp_path / "o.tif", pixels, transform, "EPSG:4326")]).surface
    assert isinstance(plan, Plan)
    rows, columns = plan.mask.shape
    assert abs(columns / rows - 80 / 60 * 0.5) < 0.05  # a degree of longitude is half as long at 60 degrees


def test_a_project_of_odm(place: tuple[Array, NDArray[np.uint8]], tmp_path: Path, rng: np.random.Generator) -> None:
    for name in ("odm_orthophoto", "odm_georeferencing", "odm_texturing"):
        (tmp_path / name).mkdir()
    transform = Affine.translation(1000, 2030) @ Affine.scale(0.5, -0.5)
    pixels = rng.integers(1, 255, (3, 60, 80), np.uint8)
    write_raster(tmp_path / "odm_orthophoto" / "odm_orthophoto.tif", pixels, transform)
    write_las(tmp_path / "odm_georeferencing" / "odm_georeferenced_model.laz", place[0] + [1000, 2000, 0], place[1])
    (tmp_path / "odm_georeferencing" / "coords.txt").write_text("WGS84 UTM 32N\n1000 2000\n")
    textured(tmp_path).export(str(tmp_path / "odm_texturing" / "odm_textured_model_geo.obj"))
    model = read_model([tmp_path])
    assert isinstance(model.surface, Plan)
    assert [(part.kind, part.offset[:2]) for part in model.parts] == [
        ("orthophoto", (0.0, 0.0)),
        ("las", (0.0, 0.0)),
        ("obj", (1000.0, 2000.0)),
    ]


def test_a_gltf_that_is_higher_than_wide_has_another_up(tmp_path: Path) -> None:
    textured(tmp_path).export(str(tmp_path / "m.glb"))
    assert read_model([tmp_path / "m.glb"]).up is None
    content = (tmp_path / "m.glb").read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    assert json.loads(content[20 : 20 + length])["asset"]["version"] == "2.0"


def test_vertices_of_a_glb_keep_their_colours_beside_a_plain_material(tmp_path: Path) -> None:
    from skymoor.geo import EnuFrame
    from skymoor.results.formats import mesh_glb

    grid = textured(tmp_path)
    colours = np.random.default_rng(0).integers(0, 255, (len(grid.vertices), 3), np.uint8)
    frame = EnuFrame(46.0, 7.0, 500.0)
    (tmp_path / "m.glb").write_bytes(mesh_glb(grid.vertices, colours, grid.faces.astype(np.uint32), frame))
    mesh = read_model([tmp_path / "m.glb"]).surface
    assert isinstance(mesh, Mesh) and mesh.colours is not None
    assert np.abs(mesh.colours.astype(int) - colours).max() <= 1
