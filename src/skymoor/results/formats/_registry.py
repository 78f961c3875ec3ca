# SPDX-License-Identifier: Apache-2.0
"""The formats: what each writes of a run into an empty folder."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import laspy
import numpy as np
import rasterio

from skymoor.engines.colmap import colmap_from_component, write_colmap
from skymoor.errors import InputError
from skymoor.geo.datum import datum_from_ellipsoid
from skymoor.results.formats._crs import enu_from_map
from skymoor.results.formats._source import Source
from skymoor.results.formats.cameras import cameras_geojson, georeference
from skymoor.results.formats.cog import write_cog
from skymoor.results.formats.exif import photo_with_position, position_xmp
from skymoor.results.formats.geopackage import cameras_geopackage
from skymoor.results.formats.gltf import height_field, mesh_glb, tileset
from skymoor.results.formats.kml import cameras_kml
from skymoor.results.formats.nerfstudio import nerfstudio_transforms
from skymoor.results.formats.odm import odm_gcp_list, odm_geo, odm_names
from skymoor.results.formats.ply import pointcloud_ply
from skymoor.results.read import RUN_FIRST
from skymoor.types import Array, Image, Mask

EGM96 = "EPSG:5773"
JPEG = (".jpg", ".jpeg")
MOST_NODES = 1_000_000  # of a mesh: what a browser still turns fluently
ELLIPSOID = "metres above the WGS 84 ellipsoid"


def _colmap(source: Source, folder: Path) -> str:
    for part, component in source.components():
        assert part.enu_from_sfm is not None
        for kind in ("bin", "text"):
            (folder / kind / part.name).mkdir(parents=True)
        write_colmap(component, folder / "bin" / part.name)
        colmap_from_component(component).write_text(str(folder / "text" / part.name))
        content = json.dumps(georeference(source.result.frame, part.enu_from_sfm, part.heights), indent=1)
        for kind in ("bin", "text"):
            (folder / kind / part.name / "georeference.json").write_text(content, encoding="utf-8")
    return f"metres up of the origin in georeference.json, which is in {ELLIPSOID}"


def _nerfstudio(source: Source, folder: Path) -> str:
    cameras = [camera for _, component in source.components() for camera in component.cameras]
    paths, lost = {}, 0
    for camera in cameras:
        try:
            found = source.result.photo(camera.image).resolve()
            paths[camera.image] = Path(os.path.relpath(found, source.target.resolve())).as_posix()
        except InputError:
            paths[camera.image], lost = camera.image, lost + 1
    if lost:
        source.notes.append(f"{lost} photos are not where the run found them: put them beside transforms.json")
    content = nerfstudio_transforms(cameras, paths, source.result.frame)
    (folder / "transforms.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"metres up of enu_origin, which is in {ELLIPSOID}"


def _laz(source: Source, folder: Path) -> str:
    shutil.copyfile(source.product("pointcloud.laz"), folder / "pointcloud.laz")
    return ELLIPSOID


def _cog(source: Source, folder: Path) -> str:
    for name in ("ortho.tif", "dsm.tif"):
        write_cog(source.product(name), folder / name)
    if (source.result.folder / "confidence.tif").is_file():  # runs of former versions have none
        write_cog(source.product("confidence.tif"), folder / "confidence.tif")
    return ELLIPSOID


def _geojson(source: Source, folder: Path) -> str:
    content = json.dumps(cameras_geojson(source.rows), ensure_ascii=False)
    (folder / "cameras.geojson").write_text(content, encoding="utf-8")
    return ELLIPSOID


def _gpkg(source: Source, folder: Path) -> str:
    (folder / "cameras.gpkg").write_bytes(cameras_geopackage(source.rows))
    return ELLIPSOID


def _kml(source: Source, folder: Path) -> str:
    position = np.array([[row.lat, row.lon, row.height] for row in source.rows], dtype=np.float64)
    if not np.isfinite(position).all():
        (folder / "cameras.kml").write_bytes(cameras_kml(source.rows, None))
        return "none, clamped to the ground"
    try:
        heights: Array | None = datum_from_ellipsoid(position[:, 0], position[:, 1], position[:, 2], EGM96)
    except InputError:
        heights = None
        source.notes.append("no EGM96 geoid grid is installed: points are clamped to the ground, without altitude")
    (folder / "cameras.kml").write_bytes(cameras_kml(source.rows, heights))
    return "none, clamped to the ground" if heights is None else "metres above the EGM96 geoid"


def _ply(source: Source, folder: Path) -> str:
    with laspy.open(source.product("pointcloud.laz")) as reader:
        cloud, crs = reader.read(), reader.header.parse_crs()
    enu = enu_from_map(np.asarray(cloud.xyz), source.result.frame, crs.to_wkt())
    colours = (np.column_stack([cloud.red, cloud.green, cloud.blue]) // 257).astype(np.uint8)
    (folder / "pointcloud.ply").write_bytes(pointcloud_ply(enu, colours, source.result.frame))
    return f"metres up of the origin in the header, which is in {ELLIPSOID}"


def _gltf(source: Source, folder: Path) -> str:
    enu, colours, known = _surface(source)
    used, faces = height_field(enu, known)
    if not len(faces):
        raise InputError(f"{source.product('dsm.tif')}: holds no surface to make a mesh of; {RUN_FIRST}")
    points = enu.reshape(-1, 3)[used]
    (folder / "model.glb").write_bytes(mesh_glb(points, colours.reshape(-1, 3)[used], faces, source.result.frame))
    content = tileset(points, source.result.frame, "model.glb")
    (folder / "tileset.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"metres up of the origin in asset.extras, which is in {ELLIPSOID}"


def _surface(source: Source) -> tuple[Array, Image, Mask]:
    """ENU positions (h, w, 3) and colours of every n-th pixel of the DSM, and where it is known."""
    with rasterio.open(source.product("dsm.tif")) as dsm, rasterio.open(source.product("ortho.tif")) as ortho:
        step = int(np.ceil(np.sqrt(dsm.width * dsm.height / MOST_NODES)))
        height, known = dsm.read(1)[::step, ::step].astype(np.float64), dsm.read_masks(1)[::step, ::step] > 0
        colours = ortho.read((1, 2, 3))[:, ::step, ::step].transpose(1, 2, 0)
        u, v = np.meshgrid(np.arange(dsm.width)[::step] + 0.5, np.arange(dsm.height)[::step] + 0.5)
        t = dsm.transform
        x, y = t.a * u + t.b * v + t.c, t.d * u + t.e * v + t.f
        crs = dsm.crs.to_wkt()
    plan = np.stack([x, y, np.where(known, height, 0.0)], axis=-1)
    return enu_from_map(plan.reshape(-1, 3), source.result.frame, crs).reshape(plan.shape), colours, known


def _exif(source: Source, folder: Path) -> str:
    sidecars = 0
    for k, row in enumerate(source.rows):
        photo = source.result.photo(row.image)
        name = PurePosixPath(row.image)
        copy = folder.joinpath(*(part for part in name.parts if part not in ("/", "..")))
        copy.parent.mkdir(parents=True, exist_ok=True)
        if photo.suffix.lower() in JPEG:
            copy.write_bytes(photo_with_position(photo.read_bytes(), row, str(photo)))
        else:
            shutil.copyfile(photo, copy)
            copy.with_suffix(".xmp").write_text(position_xmp(row), encoding="utf-8")
            sidecars += 1
        source.progress(k + 1, len(source.rows))
    source.notes.append(f"GPSAltitude is {ELLIPSOID}" + (f", {sidecars} in .xmp beside the photo" if sidecars else ""))
    return ELLIPSOID


def _odm(source: Source, folder: Path) -> str:
    # One project for each set: ODM knows photos by their bare names, which two folders may share.
    marks: dict[str, str] = {row.set: "" for row in source.rows}
    names = {name: odm_names(row.image for row in source.rows if row.set == name) for name in marks}
    for part, component in source.components():
        called = names.setdefault(part.image_set, odm_names(camera.image for camera in component.cameras))
        lines = odm_gcp_list(component, source.result.frame, part.name, called)
        marks[part.image_set] = marks.get(part.image_set, "") + lines
    for name, marked in marks.items():
        (folder / name).mkdir()
        own = [row for row in source.rows if row.set == name]
        (folder / name / "geo.txt").write_text(odm_geo(own, names[name]), encoding="utf-8")
        (folder / name / "gcp_list.txt").write_text("EPSG:4326\n" + marked, encoding="utf-8")
    source.notes.append(f"heights are {ELLIPSOID}")
    renamed = [new for called in names.values() for image, new in called.items() if new != PurePosixPath(image).name]
    if renamed:
        source.notes.append(
            f"{len(renamed)} photos have the name of another in a sub-folder: the lists put the folder before it "
            f"({renamed[0]}); rename the copies that ODM gets"
        )
    return ELLIPSOID


FORMATS: dict[str, Callable[[Source, Path], str]] = {
    "colmap": _colmap,
    "nerfstudio": _nerfstudio,
    "laz": _laz,
    "cog": _cog,
    "geojson": _geojson,
    "gpkg": _gpkg,
    "kml": _kml,
    "ply": _ply,
    "gltf": _gltf,
    "odm": _odm,
    "exif": _exif,  # last: it alone cannot do without the photos
}
"""What writes a format into an empty folder, and returns what its heights are."""
