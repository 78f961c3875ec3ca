# SPDX-License-Identifier: Apache-2.0
"""COLMAP models, binary or text, with or without their photos."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.engines.regular import is_there
from skymoor.errors import InputError
from skymoor.models.cameras import component_and_photos
from skymoor.models.checks import checked_points, readable
from skymoor.models.given import Cloud, GivenModel, Part

FILES = ("cameras", "images", "points3D")
INSIDE = ("", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse", "dense/0/sparse")
FEWEST_POINTS = 100
SMALLEST_BYTES = {"cameras": 48, "images": 73, "points3D": 51}
"""Of one camera, image or point in a binary file."""
IMAGE_HEAD, OBSERVATION = 64, 24
"""Bytes before an image's name, and of each of its observations."""
WITHOUT_PHOTOS = "{}: its photos are not beside it, so its points alone are rendered; name their folder with --photos"


def colmap_folder(path: Path) -> Path | None:
    """The folder of the model in a folder of COLMAP's, or None."""
    return next((path / one for one in INSIDE if _format(path / one) is not None), None)


def _format(folder: Path) -> str | None:
    """bin or txt, None where there is no model."""
    return next((kind for kind in ("bin", "txt") if all((folder / f"{one}.{kind}").is_file() for one in FILES)), None)


def read_colmap(path: Path, photos: Path | None = None) -> GivenModel:
    """The model in a folder, with the photos of `photos` or of the folder images beside it, if there are any.

    Raises `InputError` where it cannot be used.
    """
    folder = colmap_folder(path)
    if folder is None:
        raise InputError(f"{path}: has no COLMAP model (cameras, images and points3D, .bin or .txt)")
    model = open_colmap(folder)
    if not len(model.reg_image_ids()):
        raise InputError(f"{folder}: has no image with a pose; give the result of COLMAP's mapper")
    ids = sorted(model.point3D_ids())
    points = np.array([model.point3D(k).xyz for k in ids], np.float64).reshape(-1, 3)
    colours = np.array([model.point3D(k).color for k in ids], np.uint8).reshape(-1, 3)
    points = checked_points(points, folder, fewest=FEWEST_POINTS)
    files = found_photos([image.name for image in model.images.values()], photos, path, folder)
    component, pictures = component_and_photos(model, files, folder)
    notes = (WITHOUT_PHOTOS.format(folder),) if pictures is None else ()
    cloud = Cloud(points, colours if colours.any() else None)
    part = Part("colmap", folder)
    return GivenModel(path.name, (part,), cloud, sparse=True, component=component, photos=pictures, notes=notes)


def open_colmap(folder: Path) -> pycolmap.Reconstruction:
    """The model as COLMAP has it. Raises `InputError` where it cannot be read."""
    _require_whole(folder)
    with readable(folder, "COLMAP model"):
        return pycolmap.Reconstruction(str(folder))


def _require_whole(folder: Path) -> None:
    """COLMAP reads on for minutes behind the end of a binary file that was cut off."""
    for name, least in SMALLEST_BYTES.items():
        path = folder / f"{name}.bin"
        if not path.is_file():
            continue
        data = path.read_bytes()
        count = struct.unpack_from("<Q", data)[0] if len(data) >= 8 else 1
        whole = 8 + count * least <= len(data)
        if not whole or (name == "images" and not _images_end(data, count)):
            raise InputError(f"{path}: is cut off or no file of a COLMAP model; export the model again")


def _images_end(data: bytes, count: int) -> bool:
    """Whether all images, with their observations, lie within the file."""
    at = 8
    for _ in range(count):
        name_end = data.find(b"\0", at + IMAGE_HEAD)
        if name_end < 0 or name_end + 9 > len(data):
            return False
        at = name_end + 9 + OBSERVATION * int(struct.unpack_from("<Q", data, name_end + 1)[0])
    return at <= len(data)


def found_photos(names: list[str], stated: Path | None, *beside: Path) -> dict[str, Path]:
    """Files of the photos by their names: in `stated`, else in a folder of photos beside one of the paths."""
    if stated is not None:
        found = {name: stated / name for name in names if is_there(stated / name)}
        # Names may hold folders that were above the one that is given.
        found = found or {name: stated / Path(name).name for name in names if is_there(stated / Path(name).name)}
        if not found:
            raise InputError(f"{stated}: has none of the model's photos, such as {names[0]}; name their folder")
        return found
    folders = [base / inside for base in beside for inside in ("images", "../images", "../../images", "", "..")]
    for folder in folders:
        found = {name: folder / name for name in names if is_there(folder / name)}
        if found:
            return found
    return {}
