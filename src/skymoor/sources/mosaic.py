# SPDX-License-Identifier: Apache-2.0
"""Rasters side by side on one lattice of pixels, and the window of a bounding box in them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError
from rasterio import Affine
from rasterio.enums import MaskFlags, Resampling
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform_bounds

from skymoor.errors import InputError
from skymoor.geo.datum import horizontal_part
from skymoor.sources.layers import Layer
from skymoor.sources.remote import opened_source
from skymoor.sources.stac import HOW_TO_BOUND, BBox

Array = NDArray[np.float64]

LARGEST_PX = 400e6
MARGIN_PX = 2
# Parts of one mosaic lie on one lattice of pixels where they are off by less.
SAME_LATTICE_PX = 0.01
METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True, eq=False)
class Part:
    """A raster and its window (left, top, right, bottom) in pixels of the mosaic, which begins with the first."""

    source: Any
    box: tuple[float, float, float, float]
    name: str


def opened_parts(layer: Layer, bbox: BBox | None, stack: ExitStack) -> tuple[list[Part], CRS, Affine]:
    """All rasters, on the lattice of the first: its CRS and its transform."""
    first, crs = _opened(layer, layer.names[0], bbox, stack)
    transform = first.transform
    parts = [Part(first, (0.0, 0.0, float(first.width), float(first.height)), layer.names[0])]
    for name in layer.names[1:]:
        source, _ = _opened(layer, name, bbox, stack)
        if (source.count, source.dtypes[0]) != (first.count, first.dtypes[0]):
            raise InputError(
                f"{layer.shown}: its rasters differ in bands or type ({first.count} of {first.dtypes[0]}, "
                f"{source.count} of {source.dtypes[0]}); choose those of one kind with --date or a smaller --bbox"
            )
        parts.append(Part(*_on_lattice(source, first, stack), name))
    return parts, crs, transform


def _opened(layer: Layer, name: str, bbox: BBox | None, stack: ExitStack) -> tuple[DatasetReader, CRS]:
    source = stack.enter_context(opened_source(name, layer.label(name)))
    crs = _checked_crs(source, layer.label(name))
    level = None if layer.pixel_m is None else _level(source, crs, layer.pixel_m, bbox)
    if level is not None:
        source = stack.enter_context(opened_source(name, layer.label(name), level))
    return source, crs


def _checked_crs(source: DatasetReader, shown: str) -> CRS:
    if not source.crs or source.transform.is_identity:
        raise InputError(f"{shown}: the raster has no position on Earth (CRS and geotransform); it cannot be used")
    try:
        return horizontal_part(CRS.from_wkt(source.crs.to_wkt()))
    except CRSError as error:
        raise InputError(f"{shown}: its coordinate reference system is not known ({error})") from None


def _level(source: DatasetReader, crs: CRS, pixel_m: float, bbox: BBox | None) -> int | None:
    """The coarsest overview whose pixel is not larger; None for the raster itself."""
    bounds = bbox or transform_bounds(source.crs, "EPSG:4326", *source.bounds)
    own_m = pixel_side_m(crs, source.transform, (bounds[1] + bounds[3]) / 2)
    fine = [k for k, factor in enumerate(source.overviews(1)) if own_m * factor <= pixel_m * 1.01]
    return fine[-1] if fine else None


def _on_lattice(
    source: DatasetReader, first: DatasetReader, stack: ExitStack
) -> tuple[Any, tuple[float, float, float, float]]:
    """A raster on the lattice of the first, resampled only if it must be, and its box there."""
    if source.crs == first.crs:
        left, top = px_of(first.transform, [[source.transform.c, source.transform.f]])[0]
        same_size = np.allclose(tuple(source.transform)[:2], tuple(first.transform)[:2], rtol=1e-6, atol=1e-12)
        off = max(abs(left - round(left)), abs(top - round(top)))
        if same_size and np.isclose(source.transform.e, first.transform.e, rtol=1e-6) and off < SAME_LATTICE_PX:
            left, top = round(left), round(top)
            return source, (left, top, left + source.width, top + source.height)
    west, south, east, north = transform_bounds(source.crs, first.crs, *source.bounds, densify_pts=21)
    corners = px_of(first.transform, [[west, north], [east, south], [west, south], [east, north]])
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    warped = WarpedVRT(
        source,
        crs=first.crs,
        transform=shifted(first.transform, *low),
        width=int(high[0] - low[0]),
        height=int(high[1] - low[1]),
        resampling=Resampling.bilinear,
        add_alpha=mask_kind(source) == "none",
    )
    return stack.enter_context(warped), (float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def window_of(
    layer: Layer, parts: Sequence[Part], crs: CRS, transform: Affine, bbox: BBox | None
) -> tuple[int, int, int, int]:
    """Left, top, width and height in pixels of the mosaic."""
    boxes = np.array([one.box for one in parts])
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    if bbox is not None:
        west, south, east, north = bbox
        t = np.linspace(0.0, 1.0, 21)
        lon = np.concatenate([west + (east - west) * t, west + (east - west) * t, 0 * t + west, 0 * t + east])
        lat = np.concatenate([0 * t + south, 0 * t + north, south + (north - south) * t, south + (north - south) * t])
        try:
            project = Transformer.from_crs("EPSG:4326", crs, always_xy=True, allow_ballpark=False)
            px = px_of(transform, np.column_stack(project.transform(lon, lat)))
        except ProjError as error:
            raise InputError(f"{layer.shown}: PROJ cannot find the bounding box in its CRS ({error})") from None
        px = px[np.isfinite(px).all(axis=1)]
        if len(px):
            low = np.maximum(low, np.floor(px.min(axis=0)) - MARGIN_PX)
            high = np.minimum(high, np.ceil(px.max(axis=0)) + MARGIN_PX)
        if not len(px) or (high <= low).any():
            whole = transform_bounds(parts[0].source.crs, "EPSG:4326", *parts[0].source.bounds)
            raise InputError(f"{layer.shown}: lies outside of the bounding box; it covers {bbox_text(whole)}")
    width, height = (int(side) for side in high - low)
    return int(low[0]), int(low[1]), width, height


def require_size(layer: Layer, width: int, height: int) -> None:
    if width * height > LARGEST_PX:
        raise InputError(
            f"{layer.shown}: {width} by {height} pixels would be fetched, at most {LARGEST_PX:g} are; give a smaller "
            f"part ({HOW_TO_BOUND}), or a coarser pixel (skymoor reference --pixel M)"
        )


def mask_kind(source: DatasetReader) -> str:
    """How a raster says where it is valid: "nodata", "alpha", "mask" or "none"."""
    flags = source.mask_flag_enums[0]
    if MaskFlags.nodata in flags:
        return "nodata"
    if MaskFlags.alpha in flags:
        return "alpha"
    return "mask" if MaskFlags.per_dataset in flags else "none"


def px_of(transform: Affine, xy: ArrayLike) -> Array:
    """Pixels (n, 2) of map coordinates (n, 2)."""
    inverse = ~transform
    x, y = np.asarray(xy, dtype=np.float64).T
    return np.column_stack([inverse.a * x + inverse.b * y + inverse.c, inverse.d * x + inverse.e * y + inverse.f])


def shifted(transform: Affine, left: float, top: float) -> Affine:
    """The transform of a window that begins at a pixel."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return Affine(a, b, a * left + b * top + c, d, e, d * left + e * top + f)


def moved(box: tuple[float, float, float, float], left: int, top: int) -> tuple[float, float, float, float]:
    return box[0] - left, box[1] - top, box[2] - left, box[3] - top


def pixel_side_m(crs: CRS, transform: Affine, lat_deg: float) -> float:
    """Side of a pixel on the ground, about: web Mercator is stretched by the latitude, and degrees are no metres."""
    side = float(np.sqrt(abs(transform.determinant)))
    if crs.is_geographic:
        return side * METRES_PER_DEGREE * float(np.sqrt(np.cos(np.radians(lat_deg))))
    stretched = crs.to_epsg() == 3857
    unit = float(crs.axis_info[0].unit_conversion_factor)
    return side * unit * (float(np.cos(np.radians(lat_deg))) if stretched else 1.0)


def bbox_text(bbox: BBox) -> str:
    west, south, east, north = bbox
    return f"longitude {west:.5f} to {east:.5f}, latitude {south:.5f} to {north:.5f}"
