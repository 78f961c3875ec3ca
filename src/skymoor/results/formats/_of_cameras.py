# SPDX-License-Identifier: Apache-2.0
"""Formats of camera poses: what each writes of a run into an empty folder."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath

import numpy as np

from skymoor.errors import InputError
from skymoor.geo.datum import datum_from_ellipsoid
from skymoor.results.formats._source import ELLIPSOID, Source
from skymoor.results.formats.cameras import cameras_geojson
from skymoor.results.formats.footprints import Footprint, footprints_of, ground_of, no_heights, surface_heights
from skymoor.results.formats.geopackage import write_geopackage, write_geoparquet
from skymoor.results.formats.gltf import origin_of
from skymoor.results.formats.kml import cameras_kml
from skymoor.results.formats.metashape import metashape_cameras, metashape_reference
from skymoor.results.formats.names import table_names
from skymoor.results.formats.odm import odm_gcp_list, odm_geo, odm_names
from skymoor.results.formats.realityscan import (
    lens_groups,
    realityscan_cameras,
    realityscan_flight_log,
    realityscan_xmp,
)
from skymoor.results.formats.times import photo_times
from skymoor.results.formats.tum import tum_images, tum_trajectory
from skymoor.types import Array

EGM96 = "EPSG:5773"


def geojson(source: Source, folder: Path) -> str:
    content = json.dumps(cameras_geojson(source.rows), ensure_ascii=False)
    (folder / "cameras.geojson").write_text(content, encoding="utf-8")
    return ELLIPSOID


def gpkg(source: Source, folder: Path) -> str:
    """Cameras and footprints as layers of one GeoPackage."""
    write_geopackage(folder / "cameras.gpkg", source.rows, run_footprints(source))
    return ELLIPSOID


def geoparquet(source: Source, folder: Path) -> str:
    """Footprints as GeoParquet."""
    write_geoparquet(folder / "footprints.parquet", source.rows, run_footprints(source))
    return "none in the geometry; up of the origin in the columns up and ground_up"


def run_footprints(source: Source) -> list[Footprint]:
    """Of all photos that have one; a note says how many have none."""
    frame, path = source.result.frame, source.result.folder / "dsm.tif"
    heights = surface_heights(path, frame) if path.is_file() else no_heights
    found: list[Footprint] = []
    for _, component in source.components():
        if len(component.points):
            found += footprints_of(component.cameras, heights, ground_of(component.points), frame)
    if len(found) < len(source.rows):
        source.notes.append(f"{len(source.rows) - len(found)} photos show the horizon or far ground: no footprint")
    return found


def kml(source: Source, folder: Path) -> str:
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


def odm(source: Source, folder: Path) -> str:
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


def tum(source: Source, folder: Path) -> str:
    """Trajectories, one a component, with the times of the photos where their EXIF has them."""
    untimed = 0
    for part, component in source.components():
        times = photo_times(source, component.cameras)
        untimed += times is None
        seconds = [float(k) for k in range(len(component.cameras))] if times is None else times
        text = tum_trajectory(component.cameras, seconds, source.result.frame)
        (folder / f"{part.name}.txt").write_text(text, encoding="utf-8")
        (folder / f"{part.name}_images.txt").write_text(tum_images(component.cameras, seconds), encoding="utf-8")
    if untimed:
        source.notes.append(f"timestamps of {untimed} components count the photos: their EXIF has no distinct times")
    return f"metres up of the origin in the comments, which is in {ELLIPSOID}"


def metashape(source: Source, folder: Path) -> str:
    """For each component a reference table and an XML of poses."""
    for part, component in source.components():
        labels = table_names(camera.image for camera in component.cameras)
        text = metashape_reference([row for row in source.rows_of(part) if row.image in labels], labels)
        (folder / f"{part.name}.csv").write_text(text, encoding="utf-8")
        (folder / f"{part.name}.xml").write_bytes(metashape_cameras(component.cameras, labels))
    _write_origin(source, folder)
    return f"{ELLIPSOID} in .csv; metres up of the origin in origin.json, which is in the same, in .xml"


def realityscan(source: Source, folder: Path) -> str:
    """For each component a flight log, a table of poses and sidecars."""
    clashes = 0
    for part, component in source.components():
        names = table_names(camera.image for camera in component.cameras)
        own = folder / part.name
        own.mkdir()
        text = realityscan_flight_log([row for row in source.rows_of(part) if row.image in names], names)
        (own / "flight_log.csv").write_text(text, encoding="utf-8")
        (own / "cameras.csv").write_text(realityscan_cameras(component.cameras, names), encoding="utf-8")
        groups = lens_groups(component.cameras)
        for camera in component.cameras:
            sidecar = (own / "xmp" / names[camera.image]).with_suffix(".xmp")
            sidecar.parent.mkdir(exist_ok=True)
            clashes += sidecar.exists()
            sidecar.write_text(realityscan_xmp(camera, groups[camera.intrinsics]), encoding="utf-8")
    if clashes:
        source.notes.append(
            f"{clashes} photos differ from another in the suffix only, and share its sidecar: rename them"
        )
    _write_origin(source, folder)
    return f"{ELLIPSOID} in flight_log.csv; else metres up of the origin in origin.json, which is in the same"


def _write_origin(source: Source, folder: Path) -> None:
    (folder / "origin.json").write_text(json.dumps(origin_of(source.result.frame), indent=1), encoding="utf-8")
