# SPDX-License-Identifier: Apache-2.0
"""Local features of a large orthophoto, found once in all its detail and kept in a file beside it."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.regular import arrays_of
from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.match.features import Features, features_of, tile_features, tiles
from skymoor.match.rasters import reference_raster
from skymoor.reference.own_pixels import own_pixels
from skymoor.reference.raster import MapRaster
from skymoor.store import atomic_file
from skymoor.types import Array, Progress, Reference, no_progress

SUFFIX = ".features.npz"
VERSION = 1
FINEST_M = 0.25
"""Finer pixels are averaged to about this size: what they show beyond changes from one season to the next."""
CONVERTED = 200_000  # positions at a time


def index_path(ortho: Path) -> Path:
    """Where the features of an orthophoto are kept."""
    return ortho.with_name(ortho.name + SUFFIX)


def write_index(ortho: Path, *, progress: Progress = no_progress) -> tuple[Path, int]:
    """Find the local features of an orthophoto and keep them; returns the file and their number.

    The orthophoto is read tile by tile, so that memory does not depend on its size but for the features themselves:
    at most 3000 of 140 bytes in a million pixels. Raises `InputError` for an orthophoto that cannot be read.
    """
    step = max(1, round(FINEST_M / _pixel_m(MapRaster.of(ortho))))
    parts = []
    with own_pixels(ortho, step) as pixels:
        todo = tiles(pixels.shape)
        for done, tile in enumerate(todo):
            progress(done, len(todo))
            parts.append(tile_features(*pixels.read(*tile.window), tile))
        progress(len(todo), len(todo))
    found = Features.joined(parts)
    file = index_path(ortho)
    with atomic_file(file) as out:
        np.savez(
            out,
            version=VERSION,
            orthophoto=_sha256(ortho),
            step=step,
            px=(found.px * step).astype(np.float32),
            size=(found.size * step).astype(np.float32),
            angle=found.angle.astype(np.float32),
            descriptors=found.descriptors,
        )
    return file, len(found)


def checked_index(ortho: Path, sha256: str) -> tuple[Path | None, str]:
    """The index beside an orthophoto with this digest, if it is of it; else why it is not used, or nothing."""
    file = index_path(ortho)
    if not file.is_file():
        return None, ""
    try:
        version, orthophoto = arrays_of(file, ("version", "orthophoto"))
        if int(version) == VERSION and str(orthophoto) == sha256:
            return file, ""
    except (OSError, TypeError, ValueError):
        return None, f"{file}: is damaged and not used; make it again with skymoor index {ortho}"
    return None, f"{file}: is the index of another orthophoto and not used; make it again with skymoor index {ortho}"


def reference_features(reference: Reference, ortho: Path, index: Path | None) -> Features:
    """Features in pixels of the reference's grid: from the index of its orthophoto, or found in the grid itself."""
    if index is None:
        return features_of(reference_raster(reference))
    px, size, angle, descriptors, step = _kept(index, ortho)
    raster = MapRaster.of(ortho)
    grid_px = np.concatenate(
        [_grid_px(raster, reference, px[k : k + CONVERTED]) for k in range(0, max(1, len(px)), CONVERTED)]
    )
    scale, turn = _steps(raster, reference)
    rows, columns = reference.grid.shape
    inside = ((grid_px >= 0) & (grid_px < [columns, rows])).all(axis=1)
    return Features(grid_px[inside], size[inside] * scale, angle[inside] + turn, descriptors[inside], step * scale)


def _kept(index: Path, ortho: Path) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], int]:
    """Positions (n, 2), sizes (n,), angles (n,), descriptors (n, k), and the step. Raises `InputError`."""
    try:
        px, size, angle, descriptors, steps = arrays_of(index, ("px", "size", "angle", "descriptors", "step"))
        step, n = int(steps), len(px)
        if (px.shape, size.shape, angle.shape, descriptors.shape[:1]) != ((n, 2), (n,), (n,), (n,)) or step < 1:
            raise ValueError("its arrays do not fit together")
        if not all(np.isfinite(one).all() for one in (px, size, angle)) or descriptors.ndim != 2:
            raise ValueError("its numbers are not finite")
    except (OSError, TypeError, ValueError) as error:
        raise InputError(f"{index}: is damaged ({error}); make it again with skymoor index {ortho}") from error
    return px, size, angle, descriptors, step


def _grid_px(raster: MapRaster, reference: Reference, px: Array) -> Array:
    """Pixels of the grid of pixels of the orthophoto, both (n, 2)."""
    lonlat, frame = raster.lonlat_from_px(px), reference.frame
    return reference.grid.px_from_enu(frame.enu_from_lla(lonlat[:, 1], lonlat[:, 0], frame.height_m)[:, :2])


def _steps(raster: MapRaster, reference: Reference) -> tuple[float, float]:
    """Pixels of the grid per pixel of the orthophoto, and how far that is turned, radians from u towards v."""
    along, down = raster.pixel_sides_m(reference.frame) / reference.grid.pixel_m * [1.0, -1.0]
    if along[0] * down[1] - along[1] * down[0] <= 0:
        raise InputError(f"{raster.path}: is stored mirrored; write it again with gdalwarp, then its index")
    return float(np.sqrt(along[0] * down[1] - along[1] * down[0])), float(np.arctan2(along[1], along[0]))


def _pixel_m(raster: MapRaster) -> float:
    rows, columns = raster.shape
    lon, lat = raster.lonlat_from_px([[columns / 2, rows / 2]])[0]
    return raster.pixel_m(EnuFrame(float(lat), float(lon), 0.0))


def _sha256(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
