# SPDX-License-Identifier: Apache-2.0
"""The reference and the registered model on one grid of local metres: what maps and viewers overlay."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from skymoor.errors import InputError
from skymoor.geo import EnuFrame, Grid
from skymoor.reference.raster import MapRaster, opened, read_colours, read_heights
from skymoor.reference.read import read_part, read_reference
from skymoor.results.read import Result
from skymoor.types import Array, Array32, Image, Mask, Reference

SAME_PLACE_DEG, SAME_HEIGHT_M = 1e-7, 0.05
SPARE_M = 20.0
LARGE_PX = 40e6  # of an orthophoto, beyond which reading all of it takes minutes
AROUND_M = 150.0


@dataclass(frozen=True, eq=False)
class Mosaic:
    """Images on `grid`; None for what is missing, and `note` says why.

    Attributes:
        satellite, satellite_height: the reference (h, w, 3) and its ENU heights (h, w) in metres, NaN where unknown.
        model, model_mask, model_height: the same of what the run registered.
    """

    grid: Grid | None
    satellite: Image | None = None
    satellite_height: Array32 | None = None
    model: Image | None = None
    model_mask: Mask | None = None
    model_height: Array32 | None = None
    note: str = ""

    @cached_property
    def height_difference(self) -> Array32 | None:
        """Model minus reference (h, w) in metres, NaN where either is unknown; None without both."""
        if self.model_height is None or self.satellite_height is None:
            return None
        difference = (self.model_height - self.satellite_height).astype(np.float32)
        return difference if np.isfinite(difference).any() else None


def mosaic_of(result: Result, max_pixels: float = 1e6) -> Mosaic:
    """Lay the run's orthophoto and heights on the reference, of which no more than `max_pixels` are read."""
    reference, note = _reference(result, max_pixels)
    ortho, dsm = result.folder / "ortho.tif", result.folder / "dsm.tif"
    there = ortho.is_file() and dsm.is_file()
    grid = reference.grid if reference is not None else _grid_of(ortho, result.frame, max_pixels) if there else None
    if grid is None:
        return Mosaic(None, note=note)
    satellite, height = (None, None) if reference is None else (reference.rgb, reference.height)
    if not there:
        return Mosaic(grid, satellite, height, note=note)
    try:
        model, mask = _colours(ortho, grid, result.frame)
        up = _heights(dsm, grid, result.frame)
    except InputError as error:
        return Mosaic(grid, satellite, height, note=note or str(error))
    return Mosaic(grid, satellite, height, model, mask, up, note)


def confidence_on(result: Result, grid: Grid) -> NDArray[np.uint8] | None:
    """Confidence of the run's heights (h, w) in percent, 0 where unknown or interpolated; None where there is none."""
    path = result.folder / "confidence.tif"
    if not path.is_file():
        return None
    try:
        at, _, step = _lookup(MapRaster.of(path), grid, result.frame)
        with opened(path) as source:
            percent = np.nan_to_num(read_heights(source, Window(0, 0, source.width, source.height), step))
    except InputError:
        return None
    found = cv2.remap(percent.astype(np.uint8), at, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.uint8)


def _reference(result: Result, max_pixels: float) -> tuple[Reference | None, str]:
    files = result.summary["reference"]
    ortho, dsm = Path(files.get("ortho", "")), files.get("dsm")
    dsm = Path(dsm) if isinstance(dsm, str) else dsm  # a number is the height of the ground
    missing = next((path for path in (ortho, dsm) if isinstance(path, Path) and not path.is_file()), None)
    if missing is not None:
        return None, f"{missing}: the reference is not where the run found it; its images are left out"
    datum, area = files.get("vertical_datum"), files.get("area")
    try:
        bounds = _shown(result, ortho)
        if bounds is not None:
            west, south, east, north = bounds
            pixel_m = float(np.sqrt((east - west) * (north - south) / max_pixels))
            part = read_part(ortho, dsm, datum, result.frame, bounds, max(pixel_m, files.get("pixel_m") or 0.0))
            return Reference(result.frame, *part, result.covariance, float("nan")), ""
        found = read_reference(ortho, dsm, datum, result.covariance, max_pixels=max_pixels, area=area)
    except InputError as error:
        return None, str(error)
    moved = abs(found.frame.lat_deg - result.frame.lat_deg) + abs(found.frame.lon_deg - result.frame.lon_deg)
    if moved > SAME_PLACE_DEG or abs(found.frame.height_m - result.frame.height_m) > SAME_HEIGHT_M:
        return None, f"{ortho}: the reference is not the one of the run any more; its images are left out"
    return found, ""


def _shown(result: Result, ortho: Path) -> tuple[float, float, float, float] | None:
    """West, south, east and north of what is shown of a large reference: the cameras and what is around them.

    None where all of it is shown: because it is small, or nothing was placed in it.
    """
    rows, columns = MapRaster.of(ortho).shape
    plan = np.array([[row.east, row.north] for row in result.cameras if row.east is not None], dtype=np.float64)
    if rows * columns <= LARGE_PX or not len(plan):
        return None
    low, high = plan.min(axis=0), plan.max(axis=0)
    margin = max(float((high - low).max()), AROUND_M)
    west, south, east, north = np.concatenate([low - margin, high + margin]).tolist()
    return west, south, east, north


def _grid_of(ortho: Path, frame: EnuFrame, max_pixels: float) -> Grid | None:
    """Around the run's own orthophoto."""
    try:
        raster = MapRaster.of(ortho)
    except InputError:
        return None
    lonlat = raster.lonlat_from_px(raster.border_px())
    xy = frame.enu_from_lla(lonlat[:, 1], lonlat[:, 0], frame.height_m)[:, :2]
    (west, south), (east, north) = xy.min(axis=0) - SPARE_M, xy.max(axis=0) + SPARE_M
    pixel = max(0.1, float(np.sqrt((east - west) * (north - south) / max_pixels)))
    return Grid(float(west), float(north), pixel, (int((north - south) / pixel) + 1, int((east - west) / pixel) + 1))


def _lookup(raster: MapRaster, grid: Grid, frame: EnuFrame) -> tuple[Array32, Array, tuple[int, int]]:
    """Where each pixel of the grid lies in the raster as OpenCV counts, its lat and lon, and how much to thin out."""
    plan = grid.centres().reshape(-1, 2)
    lla = frame.lla_from_enu(np.column_stack([plan, np.zeros(len(plan))]))
    px = raster.px_from_lonlat(lla[:, 1::-1])
    # Thinned out by block means, or a fine raster would turn to noise on a coarse grid.
    ratio = grid.pixel_m / max(1e-6, raster.pixel_m(frame))
    step = max(1, int(ratio))
    return (px / step - 0.5).astype(np.float32).reshape(*grid.shape, 2), lla, (step, step)


def _colours(path: Path, grid: Grid, frame: EnuFrame) -> tuple[Image, Mask]:
    raster = MapRaster.of(path)
    at, _, step = _lookup(raster, grid, frame)
    with opened(path) as source:
        rgb, known = read_colours(source, Window(0, 0, source.width, source.height), step)
    warped = cv2.remap(np.nan_to_num(rgb).astype(np.float32), at, None, cv2.INTER_LINEAR)
    mask = cv2.remap(np.asarray(known, np.float32), at, None, cv2.INTER_LINEAR) > 0.5
    return np.clip(warped, 0, 255).astype(np.uint8), np.asarray(mask, bool)


def _heights(path: Path, grid: Grid, frame: EnuFrame) -> Array32:
    raster = MapRaster.of(path)
    at, lla, step = _lookup(raster, grid, frame)
    with opened(path) as source:
        height = read_heights(source, Window(0, 0, source.width, source.height), step).astype(np.float32)
    warped = cv2.remap(height, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    up = frame.enu_from_lla(lla[:, 0], lla[:, 1], np.nan_to_num(warped).ravel())[:, 2].reshape(grid.shape)
    return np.where(np.isfinite(warped), up, np.nan).astype(np.float32)
