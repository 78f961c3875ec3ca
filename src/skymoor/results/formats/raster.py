# SPDX-License-Identifier: Apache-2.0
"""The registered nadir render as GeoTIFFs in the reference's map projection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.io import MemoryFile
from rasterio.transform import Affine
from scipy.sparse import csr_array

from skymoor.errors import DegenerateGeometry
from skymoor.geo import EnuFrame, Grid
from skymoor.results.formats._crs import MapFrame

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

NODATA_M = -9999.0
INTERPOLATED, UNKNOWN = 0, 255
"""Confidence of pixels that were interpolated, and of those with no value; 1 to 100 is percent."""
LATTICE_PX = 32
BLOCK_ROWS = 16 * LATTICE_PX
HEIGHT_STEP_M = 100.0
MOST_PIXELS = 2**31


def geotiffs(
    rgb: NDArray[np.uint8],
    height: NDArray[np.floating],
    confidence: NDArray[np.uint8],
    grid: Grid,
    frame: EnuFrame,
    crs: str,
    pixel_size: float | None = None,
) -> tuple[bytes, bytes, bytes]:
    """Orthophoto (RGB, alpha), DSM (float32) and confidence as GeoTIFF files, north-up in the map projection `crs`.

    `rgb` (h, w, 3), `height` (h, w), ENU up in metres with NaN where nothing is known, and `confidence` (h, w) lie on
    `grid`. The DSM holds metres above the WGS 84 ellipsoid, -9999 where nothing is known. Confidence is in percent, 0
    where values were interpolated and 255 where nothing is known. `pixel_size` is in units of the CRS; by default
    that of the grid. Values are bilinear; a pixel is known where at least half of the weight is.

    Raises `InputError` for an unknown CRS and `DegenerateGeometry` when no height is known.
    """
    if rgb.shape != (*grid.shape, 3) or not height.shape == confidence.shape == grid.shape:
        raise ValueError(f"rgb {rgb.shape} and height {height.shape} do not lie on a grid of {grid.shape}")
    if not np.isfinite(height).any():
        raise DegenerateGeometry("the render has no heights, there is nothing to export")
    chart = MapFrame(frame, crs)
    target = _Target.over(grid, chart, float(np.nanmedian(height)), pixel_size)
    layers = _layers(rgb, height)
    ortho = np.zeros((4, *target.shape), np.uint8)
    dsm = np.full(target.shape, NODATA_M, np.float32)
    trust = np.full(target.shape, UNKNOWN, np.uint8)
    for rows, px, offset in target.blocks(grid, height):
        colour, up, weight = _sampled(layers, px)
        known = weight >= 0.5
        ortho[:3, rows] = np.where(known, colour.transpose(2, 0, 1), 0)
        ortho[3, rows] = np.where(known, 255, 0)
        dsm[rows] = np.where(known, up + offset, NODATA_M)
        nearest = _nearest(confidence, px)
        # Beside a hole, a value comes of the neighbours alone.
        trust[rows] = np.where(known, np.where(nearest == UNKNOWN, INTERPOLATED, nearest), UNKNOWN)
    return (
        _written(ortho, target, chart, None),
        _written(dsm[None], target, chart, NODATA_M),
        _written(trust[None], target, chart, UNKNOWN),
    )


@dataclass(frozen=True, eq=False)
class _Target:
    """A north-up raster in map coordinates; (`x0`, `y0`) is its outer top-left corner."""

    chart: MapFrame
    x0: float
    y0: float
    pixel: float
    shape: tuple[int, int]
    base_height: float  # ellipsoidal metres

    @classmethod
    def over(cls, grid: Grid, chart: MapFrame, up: float, pixel_size: float | None) -> _Target:
        west, south, east, north = grid.bounds
        s = np.linspace(0.0, 1.0, 33)
        edge = np.concatenate([np.column_stack([s, 0 * s]), np.column_stack([s, 0 * s + 1])])
        edge = np.concatenate([edge, edge[:, ::-1]])
        plan = [west, south] + edge * [east - west, north - south]
        corners = chart.map_from_enu(np.column_stack([plan, np.full(len(plan), up)]))
        east_c, north_c = (west + east) / 2, (south + north) / 2
        if pixel_size is None:
            # Along a meridian: degrees of longitude shrink towards the poles, and pixels shall be square.
            ends = chart.map_from_enu([[east_c, north_c, up], [east_c, north_c + grid.pixel_m, up]])
            pixel_size = float(np.hypot(*(ends[1] - ends[0])[:2]))
        low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
        x0, y0 = np.floor(low[0] / pixel_size) * pixel_size, np.ceil(high[1] / pixel_size) * pixel_size
        shape = (int(np.ceil((y0 - low[1]) / pixel_size)), int(np.ceil((high[0] - x0) / pixel_size)))
        if shape[0] * shape[1] > MOST_PIXELS:
            raise DegenerateGeometry(f"a raster of {shape[0]} x {shape[1]} pixels is too large to export")
        base_height = float(chart.map_from_enu([east_c, north_c, up])[0, 2])
        return cls(chart, float(x0), float(y0), float(pixel_size), shape, base_height)

    def blocks(self, grid: Grid, height: NDArray[np.floating]) -> Iterator[tuple[slice, Array, Array]]:
        """Row slices, the grid pixel (n, w, 2) that each target pixel shows, and ellipsoidal height minus up (n, w).

        The projection is smooth, so it is computed on a lattice and interpolated. The position in ENU of a map point
        depends on its height (by 1 cm for 60 m of it, 1 km from the origin): a first approximation finds the height.
        """
        lattice_v, lattice_u = (np.arange(0.0, n + LATTICE_PX, LATTICE_PX, dtype=np.float64) for n in self.shape)
        low, high = (self._enu(lattice_u, lattice_v, self.base_height + step) for step in (0.0, HEIGHT_STEP_M))
        slope = (high[..., :2] - low[..., :2]) / HEIGHT_STEP_M
        across = _linear(_centres(0, self.shape[1]), len(lattice_u))
        for start in range(0, self.shape[0], BLOCK_ROWS):
            rows = slice(start, min(start + BLOCK_ROWS, self.shape[0]))
            down = _linear(_centres(rows.start, rows.stop), len(lattice_v))
            plan = np.stack([_spread(low[..., k], down, across) for k in (0, 1)], axis=-1)
            offset = self.base_height - _spread(low[..., 2], down, across)
            lean = np.stack([_spread(slope[..., k], down, across) for k in (0, 1)], axis=-1)
            up = _nearest(height, grid.px_from_enu(plan))
            rise = np.where(np.isfinite(up), up + offset - self.base_height, 0.0)
            yield rows, grid.px_from_enu(plan + lean * rise[..., None]), offset

    def _enu(self, u: Array, v: Array, height: float) -> Array:
        x, y = np.meshgrid(self.x0 + u * self.pixel, self.y0 - v * self.pixel)
        xyz_map = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
        return self.chart.enu_from_map(xyz_map).reshape(*x.shape, 3)


def _centres(start: int, stop: int) -> Array:
    return np.arange(start, stop, dtype=np.float64) + 0.5


def _linear(px: Array, n: int) -> csr_array:
    """Weights (len(px), n) of linear interpolation between lattice lines LATTICE_PX apart."""
    position = px / LATTICE_PX
    left = np.minimum(np.floor(position).astype(int), n - 2)
    part = position - left
    row = np.arange(len(px))
    return csr_array((np.r_[1 - part, part], (np.r_[row, row], np.r_[left, left + 1])), shape=(len(px), n))


def _spread(lattice: Array, down: csr_array, across: csr_array) -> Array:
    return np.asarray((across @ (down @ lattice).T).T)


def _nearest(raster: NDArray[Any], px: Array) -> Array32:
    u, v = np.floor(np.clip(px, 0, [raster.shape[1] - 1, raster.shape[0] - 1])).astype(int).transpose(2, 0, 1)
    return np.asarray(raster[v, u], dtype=np.float32)


def _layers(rgb: NDArray[np.uint8], height: NDArray[np.floating]) -> list[Array32]:
    """Red, green, blue, height, and one; all zero where the height is not known."""
    known = np.isfinite(height)
    planes = [*rgb.transpose(2, 0, 1), height, np.ones(known.shape)]
    return [np.where(known, plane, 0).astype(np.float32) for plane in planes]


def _sampled(layers: list[Array32], px: Array) -> tuple[NDArray[np.uint8], Array32, Array32]:
    """Colour, height and known share at pixels, averaged over the known neighbours only."""
    # OpenCV puts the centre of the first pixel at (0, 0).
    u, v = (px[..., 0] - 0.5).astype(np.float32), (px[..., 1] - 0.5).astype(np.float32)
    *values, weight = (np.asarray(cv2.remap(layer, u, v, cv2.INTER_LINEAR), dtype=np.float32) for layer in layers)
    red, green, blue, height = (np.asarray(value / np.maximum(weight, 1e-3), dtype=np.float32) for value in values)
    colour = np.clip(np.rint(np.dstack([red, green, blue])), 0, 255).astype(np.uint8)
    return colour, height, weight


def _written(bands: NDArray[np.generic], target: _Target, chart: MapFrame, nodata: float | None) -> bytes:
    count, rows, columns = bands.shape
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=columns,
            height=rows,
            count=count,
            dtype=bands.dtype,
            crs=CRS.from_wkt(chart.horizontal.to_wkt()),
            transform=Affine(target.pixel, 0.0, target.x0, 0.0, -target.pixel, target.y0),
            nodata=nodata,
            tiled=True,
            compress="deflate",
            predictor=2 if bands.dtype == np.uint8 else 3,
            bigtiff="if_safer",
        ) as raster:
            if count == 4:
                raster.colorinterp = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
            elif bands.dtype == np.uint8:
                raster.set_band_description(1, "confidence of height, percent; 0: interpolated")
            else:
                raster.units = ["m"]
                raster.update_tags(VERTICAL_DATUM="ellipsoid")
                raster.set_band_description(1, "height above the WGS 84 ellipsoid")
            raster.write(bands)
        return bytes(memory.read())
