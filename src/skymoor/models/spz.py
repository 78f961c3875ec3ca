# SPDX-License-Identifier: Apache-2.0
"""Gaussian splats as SPZ, Niantic's compressed form (versions 2 and 3 of the published format)."""

from __future__ import annotations

import gzip
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.models.checks import checked_points
from skymoor.models.given import GivenModel, Part
from skymoor.models.ply import cloud_of_splat
from skymoor.types import Array

MAGIC, HEADER = 0x5053474E, "<IIIBBBB"
LARGEST_POINTS = 100_000_000
BYTES_PER_POINT = 65  # at most
COEFFICIENTS = {0: 0, 1: 3, 2: 8, 3: 15}
COLOUR_SCALE = 0.15
MOST_FRACTION_BITS = 12  # of a position: a quarter of a millimetre; fewer where it would not fit into 24 bits


def read_spz(path: Path) -> GivenModel:
    """A splat. Raises `InputError` where it cannot be used."""
    vertex = splat_of_spz(path)
    points = checked_points(np.column_stack([vertex[axis] for axis in "xyz"]), path)
    return GivenModel(path.stem, (Part("spz", path),), cloud_of_splat(points, vertex, path))


def splat_of_spz(path: Path) -> NDArray[Any]:
    """The Gaussians with the properties of a PLY of 3D Gaussian splatting. Raises `InputError`."""
    try:
        with gzip.open(path) as file:  # which may be small, and hold no end of zeros
            data = file.read(struct.calcsize(HEADER))
            magic, version, count, degree, bits, _, _ = struct.unpack(HEADER, data)
            if magic == MAGIC and count <= LARGEST_POINTS:
                data += file.read(BYTES_PER_POINT * count)
        if magic != MAGIC:
            raise ValueError("it does not begin as one")
        if version not in (2, 3) or degree not in COEFFICIENTS or count > LARGEST_POINTS:
            raise ValueError(f"version {version} with harmonics of degree {degree} is not known")
        return _unpacked(_Bytes(data, struct.calcsize(HEADER)), version, count, COEFFICIENTS[degree], bits)
    except (OSError, EOFError, MemoryError, ValueError, struct.error, zlib.error) as error:
        raise InputError(f"{path}: is no SPZ file that can be read ({error}); export it again, or as PLY") from error


def spz_of_splat(vertex: NDArray[Any]) -> bytes:
    """An SPZ file, version 3, of Gaussians with the properties of a PLY of 3D Gaussian splatting.

    Positions are rounded to a power of two, a quarter of a millimetre within 2 km; sizes to 3 %, colours, opacities and
    harmonics to a 255th of their range, rotations to a tenth of a degree. Other properties are left out. Raises
    `InputError` for positions that are farther than 8,000 km.
    """
    xyz = np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64)
    reach = max(float(np.abs(xyz).max(initial=0.0)), 1.0)
    bits = min(MOST_FRACTION_BITS, int(np.floor(np.log2((2**23 - 1) / reach))))
    if bits < 0:
        raise InputError(f"positions {reach:.0f} m from the origin do not fit into SPZ; remove them, or take PLY")
    fixed = np.rint(xyz * 2**bits).astype(np.int64)
    coefficients = sum(name.startswith("f_rest_") for name in vertex.dtype.names or ()) // 3
    degree = {count: degree for degree, count in COEFFICIENTS.items()}[coefficients]
    colours = _columns(vertex, "f_dc_", 3) * COLOUR_SCALE + 0.5
    rest = _columns(vertex, "f_rest_", 3 * coefficients).reshape(len(xyz), 3, coefficients).transpose(0, 2, 1)
    parts: list[NDArray[Any]] = [
        np.stack([fixed & 255, fixed >> 8 & 255, fixed >> 16 & 255], axis=-1).astype(np.uint8),
        _rounded(255 / (1 + np.exp(-vertex["opacity"].astype(np.float64)))),
        _rounded(colours * 255),
        _rounded((_columns(vertex, "scale_", 3) + 10) * 16),
        _smallest_three(_columns(vertex, "rot_", 4)),
        _rounded(rest * 128 + 128),
    ]
    header = struct.pack(HEADER, MAGIC, 3, len(xyz), degree, bits, 0, 0)
    return gzip.compress(header + b"".join(part.tobytes() for part in parts), mtime=0)


def _columns(vertex: NDArray[Any], prefix: str, count: int) -> Array:
    columns = [vertex[f"{prefix}{k}"] for k in range(count)]
    return np.column_stack(columns).astype(np.float64) if columns else np.zeros((len(vertex), 0))


def _rounded(values: Array) -> NDArray[np.uint8]:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _smallest_three(wxyz: Array) -> NDArray[np.uint32]:
    """Quaternions (n, 4), scalar first, as the number of the largest part and 10 bits of each of the others."""
    xyzw = wxyz[:, [1, 2, 3, 0]] / np.maximum(np.linalg.norm(wxyz, axis=1, keepdims=True), 1e-12)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(xyzw[np.arange(len(xyzw)), largest] < 0, -1, 1)[:, None]
    word = largest.astype(np.uint32)
    for k in range(4):
        size = np.rint(np.minimum(np.abs(xyzw[:, k]) / np.sqrt(0.5), 1) * 511).astype(np.uint32)
        packed = word << np.uint32(10) | (xyzw[:, k] < 0).astype(np.uint32) << np.uint32(9) | size
        word = np.where(largest == k, word, packed)
    return np.asarray(word, "<u4")


@dataclass
class _Bytes:
    """Arrays one after the other."""

    data: bytes
    at: int

    def take(self, rows: int, columns: int) -> NDArray[np.uint8]:
        found = np.frombuffer(self.data, np.uint8, rows * columns, self.at)
        self.at += rows * columns
        return found.reshape(rows, columns)


def _unpacked(source: _Bytes, version: int, count: int, coefficients: int, bits: int) -> NDArray[Any]:
    packed = source.take(count, 9).reshape(count, 3, 3).astype(np.int32)
    fixed = packed[..., 0] | packed[..., 1] << 8 | packed[..., 2] << 16
    xyz = np.where(fixed >= 1 << 23, fixed - (1 << 24), fixed) / float(1 << bits)
    opacity = np.clip(source.take(count, 1)[:, 0] / 255, 1e-4, 1 - 1e-4)
    base = (source.take(count, 3) / 255 - 0.5) / COLOUR_SCALE
    scales = source.take(count, 3) / 16 - 10
    quaternions = _quaternions(source.take(count, 3 if version == 2 else 4), version)
    rest = (source.take(count, 3 * coefficients).reshape(count, coefficients, 3).astype(np.float64) - 128) / 128
    names = [*"xyz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(3 * coefficients))]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    columns = [*xyz.T, *base.T, *rest.transpose(2, 1, 0).reshape(3 * coefficients, count)]
    columns += [np.log(opacity / (1 - opacity)), *scales.T, *quaternions.T]
    vertex = np.empty(count, [(name, "<f4") for name in names])
    for name, column in zip(names, columns, strict=True):
        vertex[name] = column
    return vertex


def _quaternions(packed: NDArray[np.uint8], version: int) -> Array:
    """Quaternions (n, 4), scalar first: x, y and z of 8 bits, or since version 3 all but the largest of 10 bits."""
    if version == 2:
        xyz = packed / 127.5 - 1
        return np.column_stack([np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1), 0)), xyz])
    word = packed.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16, 1 << 24], np.uint32)
    largest = (word >> 30).astype(int)
    xyzw, rest = np.zeros((len(packed), 4)), word.copy()
    for k in (3, 2, 1, 0):
        used = largest != k
        size = (rest & 511) / 511 * np.sqrt(0.5)
        xyzw[used, k] = np.where(rest[used] >> 9 & 1, -size[used], size[used])
        rest = np.where(used, rest >> 10, rest)
    rows = np.arange(len(packed))
    xyzw[rows, largest] = np.sqrt(np.maximum(1 - (xyzw**2).sum(axis=1), 0))
    return xyzw[:, [3, 0, 1, 2]]
