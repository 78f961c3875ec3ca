# SPDX-License-Identifier: Apache-2.0
"""Orthophoto and DSM of a model on the map: the pixels as they are, with another geotransform."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio
from rasterio import Affine
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReader, DatasetWriter
from rasterio.windows import Window

from skymoor.models.orthophoto import file_frame, raster
from skymoor.results.formats._crs import MapFrame
from skymoor.results.formats.cog import write_cog
from skymoor.results.placed.placement import Placement, local_projection
from skymoor.types import Array

STRAIGHT_PX = 0.1
"""Largest distance of a pixel of an affine geotransform from where the map projection has it."""
NODATA_M = -9999.0
BLOCK = 1024
LATTICE = 7


def move_orthophoto(path: Path, folder: Path, placement: Placement) -> list[str]:
    """As a COG whose geotransform is turned and scaled; no pixel is resampled."""
    with raster(path) as source:
        chart, transform, _ = _on_map(source, placement)
        scratch = folder / f"{path.stem}.unfinished"
        own_mask = source.mask_flag_enums[0] == [MaskFlags.per_dataset]
        profile = {"count": source.count, "dtype": source.dtypes[0], "nodata": source.nodata}
        if source.colorinterp[:3] == (ColorInterp.red, ColorInterp.green, ColorInterp.blue):
            profile["photometric"] = "RGB"
        with _new(scratch, source, chart, transform, profile) as target:
            target.colorinterp = source.colorinterp
            if source.colorinterp[0] == ColorInterp.palette:
                target.write_colormap(1, source.colormap(1))
            for window in _windows(source):
                target.write(source.read(window=window), window=window)
                if own_mask:
                    target.write_mask(source.dataset_mask(window=window), window=window)
    write_cog(scratch, _named(folder, path))
    scratch.unlink()
    return []


def move_dsm(path: Path, folder: Path, placement: Placement) -> list[str]:
    """As a COG of heights above the ellipsoid, on its own pixels."""
    with raster(path) as source:
        if source.transform.is_identity:
            return [f"{path}: is not moved, because it has no geotransform, and so its heights have no known scale"]
        chart, transform, offset = _on_map(source, placement)
        scratch = folder / f"{path.stem}.unfinished"
        profile = {"count": 1, "dtype": "float32", "nodata": NODATA_M}
        with _new(scratch, source, chart, transform, profile) as target:
            target.units = ["m"]
            target.update_tags(VERTICAL_DATUM="ellipsoid")
            for window in _windows(source):
                target.write(_moved(source, window, placement, offset), 1, window=window)
    write_cog(scratch, _named(folder, path))
    scratch.unlink()
    return []


@contextmanager
def _new(
    path: Path, source: DatasetReader, chart: MapFrame, transform: Affine, profile: Mapping[str, object]
) -> Iterator[DatasetWriter]:
    """A GeoTIFF of the size of the source, with its mask inside."""
    size = {"width": source.width, "height": source.height, "tiled": True}
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            crs=CRS.from_wkt(chart.horizontal.to_wkt()),
            transform=transform,
            compress="deflate",
            bigtiff="if_safer",
            **size,
            **profile,
        ) as target,
    ):
        yield target


def _windows(source: DatasetReader) -> Iterator[Window]:
    for top in range(0, source.height, BLOCK):
        for left in range(0, source.width, BLOCK):
            yield Window(left, top, min(BLOCK, source.width - left), min(BLOCK, source.height - top))


def _named(folder: Path, path: Path) -> Path:
    return folder / (path.name if path.suffix.lower() in (".tif", ".tiff") else f"{path.stem}.tif")


def _moved(source: DatasetReader, window: Window, placement: Placement, offset: Array) -> Array:
    values = source.read(1, window=window).astype(np.float64)
    known = (source.dataset_mask(window=window) > 0) & np.isfinite(values)
    own, _ = file_frame(source)
    v, u = np.nonzero(known)
    px = np.column_stack([u + 0.5 + window.col_off, v + 0.5 + window.row_off])
    up = placement.enu(np.column_stack([_plan(own, px), values[known]]))[:, 2]
    found = np.full(values.shape, NODATA_M, np.float32)
    found[known] = up + _quadratic(px / [source.width, source.height]) @ offset
    return found


def _on_map(source: DatasetReader, placement: Placement) -> tuple[MapFrame, Affine, Array]:
    """The map projection in which an affine geotransform is exact, that geotransform, and the ellipsoidal height minus
    ENU up as a quadratic function of the position in the raster.
    """
    own, _ = file_frame(source)
    u, v = np.meshgrid(np.linspace(0, source.width, LATTICE), np.linspace(0, source.height, LATTICE))
    px = np.column_stack([u.ravel(), v.ravel()])
    xyz = np.column_stack([_plan(own, px), np.full(len(px), placement.ground)])
    enu = placement.enu(xyz)
    design = np.column_stack([px, np.ones(len(px))])
    for crs in (placement.crs, local_projection(placement.frame)):
        chart = replace(placement, crs=crs).chart
        on_map = chart.map_from_enu(enu)
        affine = np.linalg.lstsq(design, on_map[:, :2], rcond=None)[0]
        side = np.sqrt(abs(np.linalg.det(affine[:2])))
        if np.abs(design @ affine - on_map[:, :2]).max() < STRAIGHT_PX * side:
            break
    rows = affine.T
    offset = np.linalg.lstsq(_quadratic(px / [source.width, source.height]), on_map[:, 2] - enu[:, 2], rcond=None)[0]
    return chart, Affine(*rows[0], *rows[1]), np.asarray(offset, np.float64)


def _plan(own: Affine, px: Array) -> Array:
    return np.asarray(px @ np.array([[own.a, own.d], [own.b, own.e]]) + [own.c, own.f])


def _quadratic(unit: Array) -> Array:
    u, v = unit.T
    return np.column_stack([np.ones(len(unit)), u, v, u * u, u * v, v * v])
