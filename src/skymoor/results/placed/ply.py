# SPDX-License-Identifier: Apache-2.0
"""PLY clouds, meshes and Gaussian splats in metres of the site, with all their properties."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.models.ply import is_splat, open_ply
from skymoor.models.spz import splat_of_spz, spz_of_splat
from skymoor.results.placed.placement import Placement
from skymoor.types import Array

DIRECTIONS = 200


def move_ply(path: Path, folder: Path, placement: Placement) -> list[str]:
    """Positions, normals, and of splats the sizes, rotations and colours by direction."""
    file = open_ply(path)
    vertex = moved_vertices(file["vertex"].data, placement)
    file["vertex"].data = vertex
    file.comments = [*file.comments, *placement.comments()]
    file.write(str(folder / path.name))
    return []


def move_spz(path: Path, folder: Path, placement: Placement) -> list[str]:
    """As SPZ, which rounds a second time, and as PLY, which loses nothing of it."""
    plyfile = require("plyfile", "models")
    moved = moved_vertices(splat_of_spz(path), placement)
    element = plyfile.PlyElement.describe(moved, "vertex")
    plyfile.PlyData([element], comments=placement.comments()).write(str(folder / f"{path.stem}.ply"))
    try:
        (folder / path.name).write_bytes(spz_of_splat(moved))
    except InputError as error:
        return [f"{path.name}: is written as PLY alone: {error}"]
    return [f"{path.name}: is also written as PLY, which is not rounded a second time"]


def moved_vertices(given: NDArray[Any], placement: Placement) -> NDArray[Any]:
    """Vertices in ENU metres, with their normals, and as Gaussians if they are such."""
    vertex = given.copy()
    xyz = placement.enu(np.column_stack([vertex[axis] for axis in "xyz"]))
    _put(vertex, ("x", "y", "z"), xyz)
    names = vertex.dtype.names or ()
    if {"nx", "ny", "nz"} <= set(names):
        _put(vertex, ("nx", "ny", "nz"), placement.directions(np.column_stack([vertex[f"n{axis}"] for axis in "xyz"])))
    if is_splat(names):
        _move_gaussians(vertex, placement)
    return vertex


def _put(vertex: NDArray[Any], names: tuple[str, ...], columns: Array) -> None:
    for name, column in zip(names, columns.T, strict=True):
        vertex[name] = column


def _move_gaussians(vertex: NDArray[Any], placement: Placement) -> None:
    turn = placement.enu_from_model.rotation
    for name in (one for one in vertex.dtype.names or () if one.startswith("scale_")):
        vertex[name] += np.log(placement.enu_from_model.scale)
    names = tuple(f"rot_{k}" for k in range(4))
    quaternions = np.column_stack([vertex[name] for name in names]).astype(np.float64)
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions = np.where(lengths > 0, quaternions, [1.0, 0.0, 0.0, 0.0])
    turned = Rotation.from_matrix(turn) * Rotation.from_quat(quaternions, scalar_first=True)
    _put(vertex, names, turned.as_quat(scalar_first=True))
    rest = sorted((one for one in vertex.dtype.names or () if one.startswith("f_rest_")), key=lambda one: int(one[7:]))
    if rest:
        values = np.column_stack([vertex[name] for name in rest]).astype(np.float64)
        _put(vertex, tuple(rest), turned_harmonics(values.reshape(len(vertex), 3, -1), turn).reshape(len(vertex), -1))


def turned_harmonics(coefficients: Array, turn: Array) -> Array:
    """Coefficients (n, 3, k) of the real harmonics of degrees 1 to 3 after a rotation: k is 3, 8 or 15.

    Harmonics of one degree turn among themselves; the matrix follows from their values in enough directions.
    """
    sample = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    sample /= np.linalg.norm(sample, axis=1, keepdims=True)
    now, before = _harmonics(sample), _harmonics(sample @ turn)
    found = coefficients.copy()
    for start, end in ((0, 3), (3, 8), (8, 15)):
        if end <= coefficients.shape[2]:
            matrix = np.linalg.lstsq(now[:, start:end], before[:, start:end], rcond=None)[0]
            found[..., start:end] = coefficients[..., start:end] @ matrix.T
    return found


def _harmonics(directions: Array) -> Array:
    """Values (n, 15) of the real spherical harmonics of degrees 1 to 3, in the order and with the signs of splats."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    one = 0.4886025119029199
    two = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
    three = (
        *(-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154),
        *(-0.4570457994644658, 1.445305721320277, -0.5900435899266435),
    )
    return np.column_stack(
        [
            *(-one * y, one * z, -one * x),
            *(two[0] * x * y, two[1] * y * z, two[2] * (2 * zz - xx - yy), two[3] * x * z, two[4] * (xx - yy)),
            three[0] * y * (3 * xx - yy),
            three[1] * x * y * z,
            three[2] * y * (4 * zz - xx - yy),
            three[3] * z * (2 * zz - 3 * xx - 3 * yy),
            three[4] * x * (4 * zz - xx - yy),
            three[5] * z * (xx - yy),
            three[6] * x * (xx - 3 * yy),
        ]
    )
