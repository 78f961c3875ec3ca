# SPDX-License-Identifier: Apache-2.0
"""Formats of rasters, clouds and meshes: what each writes of a run into an empty folder."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import laspy
import numpy as np
import rasterio

from skymoor.errors import InputError
from skymoor.results.formats._crs import enu_from_map
from skymoor.results.formats._source import ELLIPSOID, Source
from skymoor.results.formats.cog import write_cog
from skymoor.results.formats.copc import write_copc
from skymoor.results.formats.gltf import height_field, mesh_glb, tileset
from skymoor.results.formats.ply import pointcloud_ply
from skymoor.results.formats.stac import ASSETS, stac_item
from skymoor.results.formats.tiles import Surface, write_tiles
from skymoor.results.read import RUN_FIRST
from skymoor.types import Array, Image, Mask

MOST_NODES = 1_000_000  # of a mesh: what a browser still turns fluently
MOST_TILED = 4_000_000  # of a mesh that is shown in parts: 180 MB of files, made within a gigabyte of memory


def laz(source: Source, folder: Path) -> str:
    shutil.copyfile(source.product("pointcloud.laz"), folder / "pointcloud.laz")
    return ELLIPSOID


def copc(source: Source, folder: Path) -> str:
    """The point cloud as an octree."""
    write_copc(source.product("pointcloud.laz"), folder / "pointcloud.copc.laz", np.random.default_rng(0))
    return ELLIPSOID


def cog(source: Source, folder: Path) -> str:
    for name in ("ortho.tif", "dsm.tif"):
        write_cog(source.product(name), folder / name)
    if (source.result.folder / "confidence.tif").is_file():  # runs of former versions have none
        write_cog(source.product("confidence.tif"), folder / "confidence.tif")
    return ELLIPSOID


def ply(source: Source, folder: Path) -> str:
    with laspy.open(source.product("pointcloud.laz")) as reader:
        cloud, crs = reader.read(), reader.header.parse_crs()
    enu = enu_from_map(np.asarray(cloud.xyz), source.result.frame, crs.to_wkt())
    colours = (np.column_stack([cloud.red, cloud.green, cloud.blue]) // 257).astype(np.uint8)
    (folder / "pointcloud.ply").write_bytes(pointcloud_ply(enu, colours, source.result.frame))
    return f"metres up of the origin in the header, which is in {ELLIPSOID}"


def gltf(source: Source, folder: Path) -> str:
    enu, colours, known = _surface(source, MOST_NODES)
    used, faces = height_field(enu, known)
    if not len(faces):
        raise InputError(f"{source.product('dsm.tif')}: holds no surface to make a mesh of; {RUN_FIRST}")
    points = enu.reshape(-1, 3)[used]
    (folder / "model.glb").write_bytes(mesh_glb(points, colours.reshape(-1, 3)[used], faces, source.result.frame))
    content = tileset(points, source.result.frame, "model.glb")
    (folder / "tileset.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"metres up of the origin in asset.extras, which is in {ELLIPSOID}"


def stac(source: Source, folder: Path) -> str:
    """An item whose assets are the files of the run, where they are."""
    run, here = source.result.folder.resolve(), source.target.resolve()
    files = [name for name, *_ in ASSETS.values() if (run / name).is_file()]
    hrefs = {name: Path(os.path.relpath(run / name, here)).as_posix() for name in files}
    content = stac_item(source.result, source.finished, hrefs)
    (folder / "item.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"none in the geometry; the assets have {ELLIPSOID}"


def tiles(source: Source, folder: Path) -> str:
    """The surface in levels of detail."""

    def write(name: str, content: bytes) -> None:
        (folder / name).write_bytes(content)

    content = write_tiles(Surface(*_surface(source, MOST_TILED)), source.result.frame, write)
    if content is None:
        raise InputError(f"{source.product('dsm.tif')}: holds no surface to make a mesh of; {RUN_FIRST}")
    (folder / "tileset.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"metres up of the origin in asset.extras, which is in {ELLIPSOID}"


def _surface(source: Source, most_nodes: int) -> tuple[Array, Image, Mask]:
    """ENU positions (h, w, 3) and colours of every n-th pixel of the DSM, and where it is known."""
    with rasterio.open(source.product("dsm.tif")) as dsm, rasterio.open(source.product("ortho.tif")) as ortho:
        step = int(np.ceil(np.sqrt(dsm.width * dsm.height / most_nodes)))
        height, known = dsm.read(1)[::step, ::step].astype(np.float64), dsm.read_masks(1)[::step, ::step] > 0
        colours = ortho.read((1, 2, 3))[:, ::step, ::step].transpose(1, 2, 0)
        u, v = np.meshgrid(np.arange(dsm.width)[::step] + 0.5, np.arange(dsm.height)[::step] + 0.5)
        t = dsm.transform
        x, y = t.a * u + t.b * v + t.c, t.d * u + t.e * v + t.f
        crs = dsm.crs.to_wkt()
    plan = np.stack([x, y, np.where(known, height, 0.0)], axis=-1)
    return enu_from_map(plan.reshape(-1, 3), source.result.frame, crs).reshape(plan.shape), colours, known
