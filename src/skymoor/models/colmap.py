# SPDX-License-Identifier: Apache-2.0
"""COLMAP models, binary or text, with or without their photos."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.engines.regular import is_there, regular
from skymoor.errors import InputError
from skymoor.models.cameras import component_and_photos
from skymoor.models.checks import checked_points, readable
from skymoor.models.given import Cloud, GivenModel, Part

FILES = ("cameras", "images", "points3D")
INSIDE = ("", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse", "dense/0/sparse")
FEWEST_POINTS = 100
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
    with readable(folder, "COLMAP model"):
        for file in folder.iterdir():
            if not file.is_dir():
                regular(file)
        _require_whole(folder)
        return pycolmap.Reconstruction(str(folder))


def _require_whole(folder: Path) -> None:
    """COLMAP reads on for hours behind the end of a binary file that was cut off, or claims more than it has."""
    for name, after_record in RECORDS.items():
        path = folder / f"{name}.bin"
        if not path.is_file():
            continue
        data = path.read_bytes()
        try:
            count, at = int(struct.unpack_from("<Q", data)[0]), 8
            while count and at <= len(data):
                at, count = after_record(data, at), count - 1
        except (struct.error, ValueError):
            at = len(data) + 1
        if at > len(data):
            raise InputError(f"{path}: is cut off or no file of a COLMAP model; export the model again")


def _after_camera(data: bytes, at: int) -> int:
    return at + 40  # at least: how many parameters follow depends on its model, which COLMAP checks


def _after_image(data: bytes, at: int) -> int:
    name_end = data.index(b"\0", at + 64)
    return name_end + 9 + 24 * int(struct.unpack_from("<Q", data, name_end + 1)[0])


def _after_point(data: bytes, at: int) -> int:
    return at + 51 + 8 * int(struct.unpack_from("<Q", data, at + 43)[0])


def _after_frame(data: bytes, at: int) -> int:
    return at + 68 + 16 * int(struct.unpack_from("<I", data, at + 64)[0])


def _after_rig(data: bytes, at: int) -> int:
    sensors = int(struct.unpack_from("<I", data, at + 4)[0])
    at += 16 if sensors else 8
    for _ in range(sensors - 1):  # all but the one of reference say whether a pose follows
        at += 65 if struct.unpack_from("<?", data, at + 8)[0] else 9
    return at


RECORDS: dict[str, Callable[[bytes, int], int]] = {
    "cameras": _after_camera,
    "images": _after_image,
    "points3D": _after_point,
    "frames": _after_frame,
    "rigs": _after_rig,
}
"""Where a record of a binary file ends that begins at a byte. They raise `ValueError` and `struct.error` beyond it."""


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
