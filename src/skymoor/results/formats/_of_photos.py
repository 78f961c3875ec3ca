# SPDX-License-Identifier: Apache-2.0
"""Formats of photos with their poses: what each writes of a run into an empty folder."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath

import numpy as np

from skymoor.engines.colmap import colmap_from_component, write_colmap
from skymoor.errors import InputError
from skymoor.results.formats._source import ELLIPSOID, Source
from skymoor.results.formats.cameras import georeference
from skymoor.results.formats.exif import photo_with_position
from skymoor.results.formats.nerfstudio import nerfstudio_transforms
from skymoor.results.formats.opf import opf_project
from skymoor.results.formats.ply import pointcloud_ply
from skymoor.results.formats.splat_training import (
    pinhole_component,
    training_names,
    undistorted,
    write_photo,
    write_pinhole_model,
)
from skymoor.results.formats.times import photo_times
from skymoor.results.formats.xmp import position_xmp
from skymoor.store.photos.decode import decoded
from skymoor.types import Camera

UP_OF_ORIGIN = f"metres up of the origin in georeference.json, which is in {ELLIPSOID}"
JPEG = (".jpg", ".jpeg")
SPARSE = "sparse_pc.ply"  # nerfstudio's own name for it


def colmap(source: Source, folder: Path) -> str:
    for part, component in source.components():
        assert part.enu_from_sfm is not None
        for kind in ("bin", "text"):
            (folder / kind / part.name).mkdir(parents=True)
        write_colmap(component, folder / "bin" / part.name)
        colmap_from_component(component).write_text(str(folder / "text" / part.name))
        content = json.dumps(georeference(source.result.frame, part.enu_from_sfm, part.heights), indent=1)
        for kind in ("bin", "text"):
            (folder / kind / part.name / "georeference.json").write_text(content, encoding="utf-8")
    return UP_OF_ORIGIN


def nerfstudio(source: Source, folder: Path) -> str:
    components = [component for _, component in source.components()]
    cameras = [camera for component in components for camera in component.cameras]
    paths = _photo_paths(source, cameras, "transforms.json")
    points = np.concatenate([np.zeros((0, 3)), *(component.points for component in components)])
    colours = np.concatenate([np.zeros((0, 3), np.uint8), *(component.colours for component in components)])
    if len(points):
        (folder / SPARSE).write_bytes(pointcloud_ply(points, colours, source.result.frame))
    content = nerfstudio_transforms(cameras, paths, source.result.frame, SPARSE if len(points) else None)
    (folder / "transforms.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"metres up of enu_origin, which is in {ELLIPSOID}"


def opf(source: Source, folder: Path) -> str:
    """A project of all components."""
    cameras = [camera for _, component in source.components() for camera in component.cameras]
    paths, frame = _photo_paths(source, cameras, "project.opf"), source.result.frame
    taken = photo_times(source, cameras)
    times = [source.finished] * len(cameras) if taken is None else [datetime.fromtimestamp(one, UTC) for one in taken]
    if taken is None:
        source.notes.append("times are that of the run: the photos have no distinct ones in their EXIF")
    name = str(source.result.summary.get("site") or "skymoor")
    files = opf_project(cameras, {row.image: row for row in source.rows}, paths, times, frame, name)
    for file, content in files.items():
        (folder / file).write_text(json.dumps(content, indent=1), encoding="utf-8")
    return f"{ELLIPSOID}; calibrated positions above that of the origin, by base_to_canonical"


def _photo_paths(source: Source, cameras: Sequence[Camera], beside: str) -> dict[str, str]:
    """The way from the folder of the format to each photo; its bare name where it is not where the run found it."""
    paths, lost = {}, 0
    for camera in cameras:
        try:
            found = source.result.photo(camera.image).resolve()
            paths[camera.image] = Path(os.path.relpath(found, source.target.resolve())).as_posix()
        except InputError:
            paths[camera.image], lost = camera.image, lost + 1
    if lost:
        source.notes.append(f"{lost} photos are not where the run found them: put them beside {beside}")
    return paths


def exif(source: Source, folder: Path) -> str:
    sidecars, lenses, day = 0, source.lenses(), source.day
    for k, row in enumerate(source.rows):
        photo = source.result.photo(row.image)
        name = PurePosixPath(row.image)
        copy = folder.joinpath(*(part for part in name.parts if part not in ("/", "..")))
        copy.parent.mkdir(parents=True, exist_ok=True)
        if photo.suffix.lower() in JPEG:
            copy.write_bytes(photo_with_position(photo.read_bytes(), row, str(photo), lenses.get(row.image), day))
        else:
            shutil.copyfile(photo, copy)
            copy.with_suffix(".xmp").write_text(
                position_xmp(row, lenses.get(row.image), calibrated=day), encoding="utf-8"
            )
            sidecars += 1
        source.progress(k + 1, len(source.rows))
    source.notes.append(f"GPSAltitude is {ELLIPSOID}" + (f", {sidecars} in .xmp beside the photo" if sidecars else ""))
    return ELLIPSOID


def splat_training(source: Source, folder: Path) -> str:
    """For each component `images` without distortion and `sparse/0`, a folder that trainers open as it is."""
    total, done = len(source.rows), 0
    for part, component in source.components():
        assert part.enu_from_sfm is not None
        own = folder / part.name
        (own / "images").mkdir(parents=True)
        (own / "sparse" / "0").mkdir(parents=True)
        write_pinhole_model(pinhole_component(component), own / "sparse" / "0")
        names = training_names(component)
        for camera in component.cameras:
            photo, copy = source.result.photo(camera.image), own / "images" / names[camera.image]
            if not any(camera.intrinsics.distortion) and photo.suffix.lower() == copy.suffix.lower():
                shutil.copyfile(photo, copy)
            else:
                write_photo(undistorted(decoded(photo), camera.intrinsics), copy)
            done += 1
            source.progress(done, total)
        content = json.dumps(georeference(source.result.frame, part.enu_from_sfm, part.heights), indent=1)
        (own / "georeference.json").write_text(content, encoding="utf-8")
    return UP_OF_ORIGIN
