# SPDX-License-Identifier: Apache-2.0
"""PLY files: a cloud, a mesh with colours of its vertices, or a Gaussian splat, by the properties they have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.models.checks import checked_points, checked_triangles, geocentric_up, readable
from skymoor.models.given import Cloud, GivenModel, Mesh, Part, Surface
from skymoor.types import Array, Image

SH_0 = 0.28209479177387814
"""The constant spherical harmonic."""
OPAQUE = 0.3
"""Opacity from which a Gaussian is rendered as a point."""
COLOURS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))


def read_ply(path: Path) -> GivenModel:
    """A cloud, mesh or splat. Raises `InputError` where it cannot be used."""
    file = open_ply(path)
    vertex = file["vertex"].data
    names = vertex.dtype.names
    if {"packed_position", "packed_color"} & set(names):
        raise InputError(f"{path}: is a compressed splat of PlayCanvas; export it as an uncompressed PLY or as SPZ")
    points = checked_points(np.column_stack([vertex[axis] for axis in "xyz"]), path)
    part = (Part("ply", path),)
    surface: Surface
    if is_splat(names):
        surface = cloud_of_splat(points, vertex, path)
    else:
        faces = _triangles(file, path)
        colours = _colours(vertex)
        surface = Cloud(points, colours) if faces is None else Mesh(points, faces, colours)
    return GivenModel(path.stem, part, surface, up=geocentric_up(points))


def open_ply(path: Path) -> Any:
    """The file as plyfile has it. Raises `InputError` where it is none, or has no vertices with positions."""
    plyfile = require("plyfile", "models")
    with readable(path, "PLY file"):
        file = plyfile.PlyData.read(str(path))
        if not {"x", "y", "z"} <= set(file["vertex"].data.dtype.names):
            raise ValueError("its vertices have no x, y, z")
    return file


def is_splat(names: tuple[str, ...]) -> bool:
    """Whether the properties of the vertices are those of 3D Gaussian splatting."""
    return {"f_dc_0", "opacity", "scale_0", "rot_0"} <= set(names)


def cloud_of_splat(points: Array, vertex: NDArray[Any], path: Path) -> Cloud:
    """The centres of opaque Gaussians, with the colour that they have on average over all directions."""
    opaque = 1 / (1 + np.exp(-vertex["opacity"].astype(np.float64))) > OPAQUE
    if opaque.sum() < 500:
        raise InputError(f"{path}: only {opaque.sum()} Gaussians are opaque; train the splat longer")
    base = np.column_stack([vertex[f"f_dc_{k}"] for k in range(3)])[opaque]
    return Cloud(points[opaque], np.clip((0.5 + SH_0 * base) * 255, 0, 255).astype(np.uint8))


def _colours(vertex: NDArray[Any]) -> Image | None:
    found = next((names for names in COLOURS if set(names) <= set(vertex.dtype.names or ())), None)
    if found is None:
        return None
    values = np.column_stack([vertex[name] for name in found])
    if values.dtype.kind == "f":
        values = np.clip(np.nan_to_num(values) * (255 if values.max() <= 1 else 1), 0, 255)
    elif values.dtype.itemsize == 2:
        values = values // 257
    return values.astype(np.uint8) if values.any() else None


def _triangles(file: Any, path: Path) -> NDArray[np.int64] | None:
    """Faces as triangles (m, 3), larger ones as fans; None where there are none."""
    if "face" not in file or not len(file["face"].data):
        return None
    data = file["face"].data
    name = next((one for one in ("vertex_indices", "vertex_index") if one in data.dtype.names), None)
    if name is None:
        raise InputError(f"{path}: its faces have no vertex_indices; export it again")
    lists, count = data[name], len(file["vertex"].data)
    sizes = np.array([len(one) for one in lists])
    parts = []
    for size in np.unique(sizes[sizes >= 3]):
        corners = np.stack([np.asarray(one, np.int64) for one in lists[sizes == size]])
        parts += [corners[:, [0, k, k + 1]] for k in range(1, int(size) - 1)]
    faces = np.concatenate(parts) if parts else np.zeros((0, 3), np.int64)
    return checked_triangles(faces, count, path) if len(faces) else None
