# SPDX-License-Identifier: Apache-2.0
"""Coordinates of a model that cannot be used, each told in one line with the remedy."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.engines.regular import content_told, regular
from skymoor.errors import InputError
from skymoor.types import Array

FEWEST_POINTS = 500
"""A render of fewer shows nothing that a search could find."""
FEWEST_STEPS = 2000
"""Steps of the number format across a model: fewer blur what a render of it shows."""
EARTH_RADII_M = 6.33e6, 6.40e6
SMALLEST, LARGEST = 1e-9, 1e9
"""Extents of models in any unit that anybody uses."""
THINNEST = 1e-6


def readable(path: Path, kind: str) -> AbstractContextManager[None]:
    """Turn whatever a damaged file makes its reader raise into an `InputError`: it is no `kind`."""
    return content_told(path, f"is no {kind} that can be read", "export it again", disk=True)


def json_of(path: Path) -> Any:
    """The content of a JSON file. Raises `InputError`."""
    with readable(path, "JSON"):
        return json.loads(regular(path).read_text(encoding="utf-8"))


def checked_triangles(triangles: NDArray[np.int64], count: int, path: Path) -> NDArray[np.int64]:
    """The triangles (m, 3) of `count` vertices. Raises `InputError` where they name others."""
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < count):
        raise InputError(f"{path}: its faces name vertices that are not there; export it again")
    return triangles


def checked_points(points: ArrayLike, path: Path, *, fewest: int = FEWEST_POINTS) -> Array:
    """Points (n, 3) as doubles. Raises `InputError` where they are no model of a place."""
    given = np.asarray(points)
    if len(given) < fewest:
        raise InputError(f"{path}: has {len(given)} points, and at least {fewest} are needed; export a denser model")
    xyz = np.asarray(given, dtype=np.float64).reshape(-1, 3)
    unknown = int((~np.isfinite(xyz)).any(axis=1).sum())
    if unknown:
        raise InputError(f"{path}: {unknown} points have NaN or infinite coordinates; remove them and export it again")
    size = float(np.ptp(xyz, axis=0).max())
    if not SMALLEST < size < LARGEST:
        raise InputError(
            f"{path}: the model is {size:.3g} units across, which is no scale of sense; check what it was exported from"
        )
    _require_precision(given, size, path)
    spread = np.linalg.svd((xyz - xyz.mean(axis=0))[:: max(1, len(xyz) // 20000)], compute_uv=False)
    if spread[1] <= THINNEST * spread[0]:
        raise InputError(f"{path}: all points lie on one line; export the model again")
    return xyz


def _require_precision(points: NDArray[np.generic], size: float, path: Path) -> None:
    if points.dtype != np.float32:
        return
    largest = float(np.abs(np.asarray(points, np.float64)).max())
    step = float(np.spacing(np.float32(largest)))
    if step * FEWEST_STEPS > size:
        raise InputError(
            f"{path}: coordinates of {largest:.3g} as 32-bit floats are rounded to {step:.2g} units; export it as "
            "doubles, or with a local origin"
        )


def geocentric_up(points: Array) -> Array | None:
    """Up (3,) of points (n, 3) whose coordinates are of the size of geocentric ones in metres; else None."""
    middle = points.mean(axis=0)
    radius = float(np.linalg.norm(middle))
    # Geocentric latitude differs from the geodetic one by up to 0.2 degrees, which levelling corrects.
    return middle / radius if EARTH_RADII_M[0] < radius < EARTH_RADII_M[1] else None
