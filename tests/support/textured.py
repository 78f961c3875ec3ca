# SPDX-License-Identifier: Apache-2.0
"""Patches of random greys, something to tell places by; images cut from them in another light, and maps of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rasterio
from pyproj import Transformer

from skymoor.types import Array, Raster, Reference

SHAPE = (360, 420)
PIXEL_M = 0.5


def textured(shape: tuple[int, int], seed: int) -> Raster:
    """Rectangles of random size, direction and grey."""
    rng = np.random.default_rng(seed)
    grey = np.full(shape, 110, np.uint8)
    for _ in range(shape[0] * shape[1] // 700):
        u, v = (int(x) for x in rng.integers(0, shape[::-1]))
        size, angle = rng.integers(5, 26, 2), float(rng.uniform(0, 180))
        box = cv2.boxPoints(((float(u), float(v)), (float(size[0]), float(size[1])), angle))
        cv2.fillPoly(grey, [np.round(box).astype(np.int32)], int(rng.integers(30, 225)))
    return Raster(np.repeat(grey[..., None], 3, axis=2), np.ones(shape, bool))


def cut(reference: Raster, scale: float, azimuth_deg: float, centre: tuple[float, float]) -> Raster:
    """The image whose pixels are at `scale` and an azimuth about a place of the reference, in another light."""
    c, s = scale * np.cos(np.radians(azimuth_deg)), scale * np.sin(np.radians(azimuth_deg))
    linear = np.array([[c, -s], [s, c]])
    offset = np.array(centre) - linear @ (np.array(SHAPE[::-1]) / 2)
    matrix = np.column_stack([linear, offset + linear @ [0.5, 0.5] - 0.5])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    rgb = cv2.warpAffine(reference.rgb, matrix, SHAPE[::-1], flags=flags)
    noise = np.random.default_rng(3).normal(scale=6, size=SHAPE)[..., None]
    return Raster(np.clip(0.6 * rgb + 40 + noise, 0, 255).astype(np.uint8), np.ones(SHAPE, bool))


def write_map(path: Path, picture: Raster, turn_deg: float = 0.0) -> Path:
    """An orthophoto whose columns run `turn_deg` north of east."""
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True).transform(9.0, 47.0)
    c, s = PIXEL_M * np.cos(np.radians(turn_deg)), PIXEL_M * np.sin(np.radians(turn_deg))
    transform = rasterio.Affine(c, s, x, s, -c, y)
    rows, columns = picture.mask.shape
    profile = {"driver": "GTiff", "height": rows, "width": columns, "count": 3, "dtype": "uint8"}
    with rasterio.open(path, "w", **profile, crs="EPSG:32632", transform=transform) as file:
        file.write(picture.rgb.transpose(2, 0, 1))
    return path


def px_of(reference: Reference, ortho: Path, u: float, v: float) -> Array:
    """Pixel of the grid of a pixel of the orthophoto."""
    with rasterio.open(ortho) as file:
        x, y = file.xy(v - 0.5, u - 0.5)
    lon, lat = Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True).transform(x, y)
    plan = reference.frame.enu_from_lla([lat], [lon], reference.frame.height_m)[:, :2]
    return np.asarray(reference.grid.px_from_enu(plan)[0])
