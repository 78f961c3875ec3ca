# SPDX-License-Identifier: Apache-2.0
"""One analytic scene of colours and heights, its rasters in any layout, and whether a reference shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import Transformer

from skymoor.reference.read import read_reference
from skymoor.types import Reference

Array = NDArray[np.float64]
LAT, LON = 47.05, 8.3
DEGREE_M = 111_194.0
COVARIANCE = np.diag([1.7, 1.7, 5.4])
WIDTH_PX, HEIGHT_PX, ORTHO_M, DSM_M = 240, 200, 0.5, 1.0


def scene_colours(lat: Array, lon: Array) -> Array:
    """Waves of 60 to 70 m with a different phase in each colour, 28 to 228, (3, ...)."""
    x, y = (lon - LON) * DEGREE_M * np.cos(np.radians(LAT)), (lat - LAT) * DEGREE_M
    return np.stack([128 + 100 * np.sin(x / 9 + phase) * np.cos(y / 11 - phase) for phase in (0, 1, 2)])


def scene_height(lat: Array, lon: Array) -> Array:
    x, y = (lon - LON) * DEGREE_M * np.cos(np.radians(LAT)), (lat - LAT) * DEGREE_M
    return 450 + 8 * np.sin(x / 25) + 6 * np.cos(y / 31)


def layout(crs: str, pixel_m: float, kind: str = "north-up") -> tuple[rasterio.Affine, tuple[int, int]]:
    """Geotransform and (rows, columns) of a raster about the scene's middle, 120 m by 100 m.

    `kind` is "north-up", "south-up", "rotated", "far rotated", or "east to west", whose first column is in the east.
    """
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(LON, LAT)
    columns, rows = round(WIDTH_PX * ORTHO_M / pixel_m), round(HEIGHT_PX * ORTHO_M / pixel_m)
    across = down = pixel_m
    if crs == "EPSG:4326":
        across, down = pixel_m / DEGREE_M / np.cos(np.radians(LAT)), pixel_m / DEGREE_M
    turn = {"rotated": 30.0, "far rotated": 137.0}.get(kind, 0.0)
    flip = 1.0 if kind == "south-up" else -1.0
    across = -across if kind == "east to west" else across
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    corner = rasterio.Affine(cos * across, -sin * flip * down, x, sin * across, cos * flip * down, y)
    return moved(corner, -columns / 2, -rows / 2), (rows, columns)


def moved(transform: rasterio.Affine, columns: float, rows: float) -> rasterio.Affine:
    """The geotransform of a raster that begins so many columns and rows later."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return rasterio.Affine(a, b, a * columns + b * rows + c, d, e, d * columns + e * rows + f)


def positions(transform: rasterio.Affine, shape: tuple[int, int], crs: str) -> tuple[Array, Array]:
    """Latitude and longitude (rows, columns) of the pixel centres."""
    u, v = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    x, y = transform.a * u + transform.b * v + transform.c, transform.d * u + transform.e * v + transform.f
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)
    return np.asarray(lat), np.asarray(lon)


def write(path: Path, bands: NDArray[Any], transform: rasterio.Affine | None, crs: str | None, **profile: Any) -> Path:
    tags = {"driver": "GTiff", "count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    place = {} if transform is None else {"transform": transform}
    with rasterio.open(path, "w", crs=crs, dtype=bands.dtype, **tags, **place, **profile) as raster:
        raster.write(bands)
    return path


def write_ortho(folder: Path, crs: str = "EPSG:32632", kind: str = "north-up", pixel_m: float = ORTHO_M) -> Path:
    transform, shape = layout(crs, pixel_m, kind)
    colours = np.rint(scene_colours(*positions(transform, shape, crs))).astype(np.uint8)
    return write(folder / "ortho.tif", colours, transform, crs)


def write_dsm(folder: Path, crs: str = "EPSG:32632", kind: str = "north-up", pixel_m: float = DSM_M) -> Path:
    transform, shape = layout(crs, pixel_m, kind)
    heights = scene_height(*positions(transform, shape, crs.split("+")[0])).astype(np.float32)
    return write(folder / "dsm.tif", heights[None], transform, crs)


def rewrite(path: Path, change: Any = None, **profile: Any) -> Path:
    """Write a raster again with changed bands or profile."""
    with rasterio.open(path) as raster:
        bands, transform, crs = raster.read(), raster.transform, raster.crs
    path.unlink()
    return write(path, bands if change is None else change(bands), transform, crs, **profile)


def read(ortho: Path, dsm: Path, datum: str | None = "ellipsoid", **options: Any) -> Reference:
    return read_reference(ortho, dsm, datum, COVARIANCE, **options)


def truth(reference: Reference) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Scene colours (n, 3) and heights (n,) where the reference has both, and the mask of those pixels.

    The place on Earth of a pixel includes the height that the reference states, so that every error shows.
    """
    known = reference.mask & np.isfinite(reference.height)
    lla = reference.frame.lla_from_enu(np.column_stack([reference.grid.centres()[known], reference.height[known]]))
    up_of_truth = reference.height[known] + scene_height(lla[:, 0], lla[:, 1]) - lla[:, 2]
    return scene_colours(lla[:, 0], lla[:, 1]).T, up_of_truth, known


def assert_is_the_scene(reference: Reference, *, colour: float = 1.5, height_m: float = 0.01) -> None:
    """A shift by a tenth of a pixel (5 cm) changes colours by about 0.4 on average and heights by 1 cm."""
    colours, up, known = truth(reference)
    assert known.mean() > 0.5
    difference = reference.rgb[known] - colours
    assert np.abs(difference).mean() < 0.35, "the orthophoto is shifted"
    assert np.quantile(np.abs(difference), 0.99) < colour, "the orthophoto is distorted"
    assert np.abs(reference.height[known] - up).max() < height_m, "the heights are wrong or shifted"
