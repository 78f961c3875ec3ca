# SPDX-License-Identifier: Apache-2.0
"""An orthophoto without a position on Earth, or with a wrong one, and its DSM."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio import Affine
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from skymoor.errors import InputError
from skymoor.models.given import Z_UP, GivenModel, Part, Plan
from skymoor.types import Array32, Image, Mask

LARGEST_PX = 2048
"""Long side that is read: as fine as the renders of other models."""
METRES_PER_DEGREE = 111_320.0
SHORTEST_PX = 32
SMALLEST_SHARE = 0.01


def read_orthophoto(ortho: Path, dsm: Path | None) -> GivenModel:
    """The model that an orthophoto and its DSM are. Raises `InputError` where it cannot be read."""
    with raster(ortho) as source:
        if min(source.height, source.width) < SHORTEST_PX:
            raise InputError(f"{ortho}: is only {source.width} by {source.height} pixels; give a larger orthophoto")
        model_from_px, unit_m = file_frame(source)
        width, height = _sides(model_from_px)
        pixel = max(min(width, height), max(width * source.width, height * source.height) / LARGEST_PX)
        shape = (max(1, round(source.height * height / pixel)), max(1, round(source.width * width / pixel)))
        rgb, mask = _colours(source, shape, ortho)
        scaled = dsm is not None and _has_position(dsm) and not source.transform.is_identity
        heights = _heights(dsm, source, shape) if dsm is not None and scaled else None
        own = model_from_px @ Affine.scale(source.width / shape[1], source.height / shape[0])
    if mask.mean() < SMALLEST_SHARE:
        raise InputError(f"{ortho}: has no data in {1 - mask.mean():.0%} of its pixels; check its nodata value")
    if scaled and heights is None:
        raise InputError(f"{dsm}: has no heights where {ortho} has colours; give the DSM that belongs to it")
    if own.determinant > 0:  # rows go north
        rgb, mask, heights = rgb[::-1], mask[::-1], None if heights is None else heights[::-1]
        own = own @ Affine.translation(0, shape[0]) @ Affine.scale(1, -1)
    parts = [Part("orthophoto", ortho), *([] if dsm is None else [Part("dsm", dsm)])]
    plan = Plan(np.ascontiguousarray(rgb), mask, heights, np.array(own[:6], np.float64).reshape(2, 3))
    return GivenModel(ortho.stem, tuple(parts), plan, up=Z_UP, unit_m=unit_m)


@contextmanager
def raster(path: Path) -> Iterator[DatasetReader]:
    """A raster with or without a position. Raises `InputError` where it cannot be read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as source:
                yield source
    except (RasterioError, ValueError) as error:
        raise InputError(f"{path}: is no raster that GDAL reads ({error}); export it again as a GeoTIFF") from error


def is_height_raster(path: Path) -> bool:
    """Whether a raster holds heights, and not colours."""
    with raster(path) as source:
        return bool(source.count == 1 and np.dtype(source.dtypes[0]) not in (np.dtype("u1"), np.dtype("bool")))


def file_frame(source: DatasetReader) -> tuple[Affine, float | None]:
    """The coordinates of a raster as a model's, from its pixels; and metres of their unit, where the file says it.

    They are those of the geotransform, if that keeps angles. Degrees do not: for them, as for a raster without a
    position, they are local, in metres or in pixels.
    """
    transform: Affine = source.transform
    if transform.is_identity or transform.is_degenerate:
        return Affine.scale(1, -1), None
    if source.crs is not None and source.crs.is_geographic:
        width, height = _sides(transform)
        middle = transform.f + transform.e * source.height / 2
        across = width * METRES_PER_DEGREE * float(np.cos(np.radians(middle)))
        return Affine.scale(across, -np.sign(-transform.e) * height * METRES_PER_DEGREE), 1.0
    projected = source.crs is not None and source.crs.is_projected
    return transform, float(source.crs.linear_units_factor[1]) if projected else None


def _sides(transform: Affine) -> tuple[float, float]:
    """Width and height of a pixel."""
    return float(np.hypot(transform.a, transform.d)), float(np.hypot(transform.b, transform.e))


def _colours(source: DatasetReader, shape: tuple[int, int], path: Path) -> tuple[Image, Mask]:
    """RGB (h, w, 3), and where it is known."""
    colour = [k + 1 for k, kind in enumerate(source.colorinterp) if kind != ColorInterp.alpha]
    bands = colour[:3] if len(colour) >= 3 else [colour[0]] * 3 if colour else []
    if not bands:
        raise InputError(f"{path}: has no band of colours; give the orthophoto")
    values = source.read(bands, out_shape=(3, *shape), resampling=Resampling.average)
    known = source.dataset_mask(out_shape=shape, resampling=Resampling.nearest) > 0
    if values.dtype != np.uint8:
        values = np.nan_to_num(values.astype(np.float32))
        low, high = np.percentile(values[:, known], [1, 99]) if known.any() else (0.0, 1.0)
        values = np.clip((values - low) / max(float(high - low), 1e-9) * 255, 0, 255).astype(np.uint8)
    rgb = np.ascontiguousarray(values.transpose(1, 2, 0))
    if known.all():  # many programs fill the border with one colour and declare nothing
        known = ~_border(rgb)
    return rgb, known


def _border(rgb: Image) -> Mask:
    """Pixels of one even colour, black or white, that hang together with the image's edge."""
    outside = np.zeros(rgb.shape[:2], bool)
    for value in (0, 255):
        _, labels = cv2.connectedComponents((rgb == value).all(axis=2).astype(np.uint8))
        edge = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
        outside |= np.isin(labels, edge[edge > 0])
    return outside


def _has_position(dsm: Path) -> bool:
    """Whether a DSM has a geotransform: without one nothing says how its heights compare with its pixels."""
    with raster(dsm) as source:
        return not source.transform.is_identity


def _heights(dsm: Path, ortho: DatasetReader, shape: tuple[int, int]) -> Array32 | None:
    """Heights (h, w) on the orthophoto's pixels, NaN where unknown; None where none are."""
    with raster(dsm) as source:
        if source.crs is not None and ortho.crs is not None and source.crs != ortho.crs:
            raise InputError(f"{dsm}: has another coordinate reference system than its orthophoto; warp it to that")
        dsm_from_ortho = ~source.transform @ ortho.transform
        step = max(1.0, max(source.height, source.width) / (2 * LARGEST_PX))
        size = max(1, round(source.height / step)), max(1, round(source.width / step))
        heights = source.read(1, out_shape=size, resampling=Resampling.nearest).astype(np.float32)
        known = source.dataset_mask(out_shape=size, resampling=Resampling.nearest) > 0
        small = Affine.scale(size[1] / source.width, size[0] / source.height)
    known &= np.isfinite(heights) & (heights > -9000) & (heights < 1e5)
    heights = np.where(known, heights, np.nan).astype(np.float32)
    matrix = small @ dsm_from_ortho @ Affine.scale(ortho.width / shape[1], ortho.height / shape[0])
    u, v = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    x, y = matrix.a * u + matrix.b * v + matrix.c, matrix.d * u + matrix.e * v + matrix.f
    found = cv2.remap(
        heights,
        (x - 0.5).astype(np.float32),
        (y - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float("nan"),
    )
    return np.asarray(found, np.float32) if np.isfinite(found).any() else None
