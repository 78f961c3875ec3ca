# SPDX-License-Identifier: Apache-2.0
"""Bundler's bundle.out, as many programs export it, with the list of its images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skymoor.models.checks import checked_points, readable
from skymoor.models.colmap import FEWEST_POINTS, WITHOUT_PHOTOS, found_photos
from skymoor.models.given import Cloud, GivenModel, Part
from skymoor.models.posed import Posed, component_of_posed
from skymoor.store.photos import PhotoFile, check_photos
from skymoor.types import Array, Image

LISTS = ("{stem}.list.txt", "list.txt", "{stem}_list.txt", "images.txt")
BACKWARDS = np.diag([1.0, -1.0, -1.0])
"""Bundler's cameras look along -z, with y up."""


def read_bundler(path: Path, photos: Path | None = None) -> GivenModel:
    """Cameras and points; cameras only where their photos are there, since the file does not state their size.

    Raises `InputError` where it cannot be used.
    """
    with readable(path, "Bundler file"):
        cameras, points, colours = parsed(path)
    points = checked_points(points, path, fewest=FEWEST_POINTS)
    cloud, part = Cloud(points, colours if colours.any() else None), (Part("bundler", path),)
    listed = next((path.parent / one.format(stem=path.stem) for one in LISTS if _is_list(path, one)), None)
    names: list[str] = []
    if listed is not None:
        with readable(listed, "list of Bundler's images"):
            names = [line.split()[0] for line in listed.read_text().splitlines() if line.strip()]
    files = found_photos(names, photos, path.parent) if names else {}
    used = [(name, row) for name, row in zip(names, cameras, strict=False) if name in files and row[0, 0] > 0]
    if len(used) < 3:
        return GivenModel(path.stem, part, cloud, sparse=True, notes=(WITHOUT_PHOTOS.format(path),))
    sizes = check_photos([PhotoFile(name, files[name]) for name, _ in used])
    posed = [_posed(name, row, size) for (name, row), size in zip(used, sizes, strict=True)]
    component, pictures = component_of_posed(posed, points, colours, files, path)
    return GivenModel(path.stem, part, cloud, sparse=True, component=component, photos=pictures)


def _is_list(path: Path, name: str) -> bool:
    return (path.parent / name.format(stem=path.stem)).is_file()


def parsed(path: Path) -> tuple[Array, Array, Image]:
    """Cameras (n, 5, 3), each f k1 k2, rotation and translation; points (m, 3) and colours (m, 3). `ValueError`."""
    lines = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    n_cameras, n_points = (int(word) for word in lines[0].split()[:2])
    start = 1 + 5 * n_cameras
    cameras = np.array([line.split() for line in lines[1:start]], np.float64).reshape(n_cameras, 5, 3)
    rows = lines[start : start + 3 * n_points]
    if len(rows) < 3 * n_points:
        raise ValueError("it ends too early")
    points = np.array([line.split() for line in rows[::3]], np.float64).reshape(-1, 3)
    colours = np.array([line.split() for line in rows[1::3]], np.float64).reshape(-1, 3)
    return cameras, points, np.clip(colours, 0, 255).astype(np.uint8)


def _posed(name: str, row: Array, size: tuple[int, int]) -> Posed:
    focal, k1, k2 = row[0].tolist()
    width, height = size
    rotation, translation = BACKWARDS @ row[1:4], BACKWARDS @ row[4]
    return Posed(name, "RADIAL", width, height, (focal, width / 2, height / 2, k1, k2), rotation, translation)
