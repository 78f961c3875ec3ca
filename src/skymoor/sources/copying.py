# SPDX-License-Identifier: Apache-2.0
"""A part of one raster, or of several side by side, as a GeoTIFF of its own: pixels are copied and not resampled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from rasterio import Affine
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader, DatasetWriter
from rasterio.warp import transform_bounds
from rasterio.windows import Window

from skymoor.errors import InputError
from skymoor.geo.datum import vertical_datum_of
from skymoor.sources.layers import Layer
from skymoor.sources.mosaic import (
    Part,
    bbox_text,
    mask_kind,
    moved,
    opened_parts,
    pixel_side_m,
    require_size,
    shifted,
    window_of,
)
from skymoor.sources.remote import reported
from skymoor.sources.stac import BBox
from skymoor.types import Mask, Progress

BLOCK_PX = 1024


@dataclass(frozen=True)
class Copied:
    """What was copied: size in pixels, side of a pixel in metres, datum of the heights where the CRS states one."""

    width: int
    height: int
    pixel_m: float
    vertical_datum: str | None
    bbox: BBox
    known_share: float
    is_image: bool


def copy_part(layer: Layer, target: Path, bbox: BBox | None, tags: dict[str, str], progress: Progress) -> Copied:
    """Copy the bounding box (west, south, east, north; None for everything) of a layer to a GeoTIFF.

    The CRS, data type, nodata value, mask and units stay those of the source. Parts in another CRS or on another
    lattice than the first are resampled to it. Raises `InputError` when something cannot be read, the box is outside,
    or it has more than `LARGEST_PX` pixels.
    """
    with ExitStack() as stack:
        parts, crs, transform = opened_parts(layer, bbox, stack)
        first = parts[0].source
        left, top, width, height = window_of(layer, parts, crs, transform, bbox)
        require_size(layer, width, height)
        placed = shifted(transform, left, top)
        mosaic = [Part(one.source, moved(one.box, left, top), one.name) for one in parts]
        profile = _profile(first, width, height, placed)
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(target, "w", **profile) as written:
            _label(written, first, tags)
            known = _write_blocks(mosaic, written, layer, progress)
        found = transform_bounds(first.crs, "EPSG:4326", *rasterio.transform.array_bounds(height, width, placed))
        if not known:
            finer = ", or give a coarser --pixel: it has no tiles of this level" if layer.is_worldwide else ""
            where = bbox_text(bbox or found)
            raise InputError(f"{layer.shown}: holds no valid pixel in {where}; check the bounding box{finer}")
        datum = vertical_datum_of(CRS.from_wkt(first.crs.to_wkt()))
        is_image = first.count >= 3 and first.dtypes[0] == "uint8"
        pixel_m = pixel_side_m(crs, placed, (found[1] + found[3]) / 2)
        return Copied(width, height, pixel_m, datum, found, known / (width * height), is_image)


def _write_blocks(parts: Sequence[Part], written: DatasetWriter, layer: Layer, progress: Progress) -> int:
    """Copy block by block; returns how many pixels are valid. A mask is written only where something must be masked."""
    kind = mask_kind(parts[0].source)
    incomplete: list[tuple[Window, Mask]] = []
    known, blocks = 0, list(_blocks(written.width, written.height))
    for done, window in enumerate(blocks):
        progress(done, len(blocks))
        values, valid = _block(parts, window, written, layer)
        written.write(values, window=window)
        known += int(valid.sum())
        if not valid.all():
            incomplete.append((window, valid))
    if kind in ("mask", "none") and incomplete:
        of_window = {(window.col_off, window.row_off): valid for window, valid in incomplete}
        for window in blocks:
            whole = np.ones((window.height, window.width), bool)
            written.write_mask(of_window.get((window.col_off, window.row_off), whole), window=window)
    progress(len(blocks), len(blocks))
    return known


def _block(parts: Sequence[Part], window: Window, written: DatasetWriter, layer: Layer) -> tuple[NDArray[Any], Mask]:
    """Values (bands, h, w) of a window of the mosaic, and where they are valid (h, w)."""
    nodata = written.nodata if written.nodata is not None else 0
    values = np.full((written.count, window.height, window.width), nodata, written.dtypes[0])
    valid: Mask = np.zeros((window.height, window.width), bool)
    for part in parts:
        inner = _common(window, part)
        if inner is None:
            continue
        rows, columns, own = inner
        if valid[rows, columns].all():
            continue
        with reported(part.name, layer.label(part.name)):
            read = part.source.read(list(range(1, written.count + 1)), window=own)
            there = part.source.dataset_mask(window=own) > 0
        new = there & ~valid[rows, columns]
        # The values under a mask are copied as well where there are no others: nothing is lost.
        values[:, rows, columns] = np.where(new | ~(there | valid[rows, columns]), read, values[:, rows, columns])
        valid[rows, columns] |= there
    return values, valid


def _common(window: Window, part: Part) -> tuple[slice, slice, Window] | None:
    """Rows and columns of a window that a part covers, and the same as a window of the part."""
    left, top, right, bottom = (round(side) for side in part.box)
    c0, r0 = max(window.col_off, left), max(window.row_off, top)
    c1, r1 = min(window.col_off + window.width, right), min(window.row_off + window.height, bottom)
    if c1 <= c0 or r1 <= r0:
        return None
    rows = slice(r0 - window.row_off, r1 - window.row_off)
    columns = slice(c0 - window.col_off, c1 - window.col_off)
    return rows, columns, Window(c0 - left, r0 - top, c1 - c0, r1 - r0)


def _blocks(width: int, height: int) -> Iterator[Window]:
    for top in range(0, height, BLOCK_PX):
        for left in range(0, width, BLOCK_PX):
            yield Window(left, top, min(BLOCK_PX, width - left), min(BLOCK_PX, height - top))


def _profile(first: DatasetReader, width: int, height: int, transform: Affine) -> dict[str, Any]:
    floating = np.issubdtype(np.dtype(first.dtypes[0]), np.floating)
    return {
        "driver": "GTiff",
        "width": width,
        "height": height,
        "count": first.count,
        "dtype": first.dtypes[0],
        "crs": first.crs,
        "transform": transform,
        "nodata": first.nodata,
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
        "compress": "deflate",
        "predictor": 3 if floating else 2,
        "bigtiff": "if_safer",
    }


def _label(written: DatasetWriter, first: DatasetReader, tags: dict[str, str]) -> None:
    """What the source says of its bands, and where it is from."""
    written.colorinterp = first.colorinterp
    written.scales, written.offsets, written.units = first.scales, first.offsets, first.units
    if first.colorinterp[0] == ColorInterp.palette:
        written.write_colormap(1, first.colormap(1))
    written.update_tags(**tags)
