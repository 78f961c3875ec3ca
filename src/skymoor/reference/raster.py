# SPDX-License-Identifier: Apache-2.0
"""Map rasters: their coverage, and reading them with all checks."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import rasterio
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError
from rasterio import Affine
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader
from rasterio.windows import Window

from skymoor.errors import InputError
from skymoor.geo import EnuFrame, vertical_datum_of
from skymoor.geo.datum import horizontal_part, vertical_unit_of

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# Bytes, as rasterio takes a number; GDAL itself would take a small one for megabytes.
GDAL_CACHE_BYTES = 256 * 2**20
# Largest strip or tile of a raster: GDAL decodes whole ones.
LARGEST_BLOCK_BYTES = 512e6
FARTHEST_PX = 1e9  # outside of every raster


def raster_files(*paths: Path) -> list[Path]:
    """All files that rasters consist of: themselves, world files and masks beside them, and the sources of a VRT."""
    found: list[Path] = []
    for path in paths:
        try:
            with opened(path) as source:
                found += [Path(name) for name in source.files]
        except InputError:  # the reader reports what is wrong
            found.append(path)
    return found


@dataclass(frozen=True, eq=False)
class MapRaster:
    """Georeference of a raster. Pixels (n, 2): u along columns, v along rows, first pixel centre at (0.5, 0.5).

    `map_from_px` is GDAL's geotransform, `shape` is (rows, columns), `vertical_datum` and `vertical_unit_m` are those
    of the CRS or None.
    """

    path: Path
    crs: CRS
    vertical_datum: str | None
    map_from_px: Affine
    shape: tuple[int, int]
    vertical_unit_m: float | None = None

    @classmethod
    def of(cls, path: Path) -> MapRaster:
        """Read the header. Raises `InputError` for a file that is missing, unreadable or not georeferenced."""
        with opened(path) as source:
            wkt = source.crs.to_wkt() if source.crs else ""
            transform, shape, points = source.transform, (source.height, source.width), source.gcps[0]
            _require_readable(source, path)
        if transform.is_identity or transform.is_degenerate:
            hint = "warp it with gdalwarp" if points else "export it again as a GeoTIFF with its position"
            raise InputError(f"{path}: the raster has no geotransform and so no position; {hint}")
        if not wkt:
            raise InputError(
                f"{path}: the raster has no coordinate reference system; assign it, e.g. gdal_edit -a_srs EPSG:32632"
            )
        try:
            crs = CRS.from_wkt(wkt)
            raster = cls(path, horizontal_part(crs), vertical_datum_of(crs), transform, shape, vertical_unit_of(crs))
            lon, lat = raster.lonlat_from_px([[shape[1] / 2, shape[0] / 2]])[0]
        except (CRSError, ProjError) as error:
            raise InputError(
                f"{path}: PROJ has no transformation from its coordinate reference system to WGS 84 "
                f"({str(error).rstrip('.')}); assign the right one with gdal_edit -a_srs"
            ) from None
        if not (raster.crs.is_projected or raster.crs.is_geographic):
            raise InputError(
                f"{path}: its coordinate reference system ({crs.name}) is neither projected nor geographic; "
                "warp the raster to one that is"
            )
        if not (np.isfinite(lon) and abs(lat) <= 90):
            raise InputError(f"{path}: its position is outside the area of its coordinate reference system; check both")
        return raster

    def px_from_lonlat(self, lonlat: ArrayLike) -> Array:
        """Pixels (n, 2) of WGS 84 longitudes and latitudes (n, 2) in degrees; infinite outside the projection."""
        lon, lat = np.asarray(lonlat, dtype=np.float64).reshape(-1, 2).T
        x, y = self._map_from_lonlat.transform(lon, lat)
        if self.crs.is_geographic:
            # Longitudes of a raster across the antimeridian may run beyond 180 degrees.
            middle = _affine(self.map_from_px, np.array([[self.shape[1] / 2, self.shape[0] / 2]]))[0, 0]
            x = middle + (np.asarray(x) - middle + 180.0) % 360.0 - 180.0
        return _affine(~self.map_from_px, np.column_stack([x, y]))

    def lonlat_from_px(self, px: ArrayLike) -> Array:
        """WGS 84 longitudes and latitudes (n, 2) in degrees of pixels (n, 2)."""
        xy = _affine(self.map_from_px, np.asarray(px, dtype=np.float64).reshape(-1, 2))
        return np.column_stack(self._map_from_lonlat.transform(xy[:, 0], xy[:, 1], direction="INVERSE"))

    @cached_property
    def _map_from_lonlat(self) -> Transformer:
        # Ballpark transformations ignore the datum, which can cost hundreds of metres without an error.
        return Transformer.from_crs("EPSG:4326", self.crs, always_xy=True, allow_ballpark=False)

    def border_px(self, steps: int = 32) -> Array:
        """Pixels (4 * steps, 2) along the outer border."""
        rows, columns = self.shape
        t = np.arange(steps) / steps
        one, zero = np.ones(steps), np.zeros(steps)
        unit = np.vstack([np.column_stack(side) for side in ((t, zero), (one, t), (1.0 - t, one), (zero, 1.0 - t))])
        return unit * [columns, rows]

    def extent(self) -> str:
        """The covered range of latitude and longitude, as text."""
        lonlat = self.lonlat_from_px(self.border_px())
        (west, south), (east, north) = lonlat.min(axis=0), lonlat.max(axis=0)
        return f"{self.path} covers latitude {south:.5f} to {north:.5f}, longitude {west:.5f} to {east:.5f}"

    def pixel_sides_m(self, frame: EnuFrame) -> Array:
        """Vectors (2, 2) in metres of one step along u and along v at the origin of a frame."""
        px = self.px_from_lonlat([[frame.lon_deg, frame.lat_deg]])[0]
        lonlat = self.lonlat_from_px(px + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
        xy = frame.enu_from_lla(lonlat[:, 1], lonlat[:, 0], frame.height_m)[:, :2]
        return np.array([xy[0] - xy[1], xy[2] - xy[3]])

    def pixel_m(self, frame: EnuFrame) -> float:
        """Side in metres of a square as large as a pixel at the origin of a frame."""
        return float(np.sqrt(abs(np.linalg.det(self.pixel_sides_m(frame)))))


@contextmanager
def opened(path: Path) -> Iterator[DatasetReader]:
    """Open a raster; a file that is missing or that GDAL cannot open is an `InputError` that names it."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path")
    _require_files_beside(path)
    with _named_errors(str(path)), warnings.catch_warnings():
        # A raster without a position is an error that names it, not a warning.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        # GDAL reports the vertical CRS of older GeoTIFFs on request only.
        with rasterio.Env(GTIFF_REPORT_COMPD_CS=True, GDAL_CACHEMAX=GDAL_CACHE_BYTES):
            source = rasterio.open(path)
    with source:
        yield source


def _require_files_beside(path: Path) -> None:
    """GDAL reads what lies beside a raster, such as its world file, and would wait for the end of a pipe."""
    for one in path.parent.iterdir():
        if one.name.startswith(path.stem) and one.exists() and not (one.is_file() or one.is_dir()):
            raise InputError(f"{one}: is a pipe or device beside the raster {path.name}; remove it")


def _require_readable(source: DatasetReader, path: Path) -> None:
    if any(kind.startswith("complex") for kind in source.dtypes):
        raise InputError(f"{path}: its pixels are complex numbers, neither colours nor heights; check the file")
    for (rows, columns), kind in zip(source.block_shapes, source.dtypes, strict=True):
        block_bytes = rows * columns * np.dtype(kind).itemsize
        if block_bytes > LARGEST_BLOCK_BYTES:
            raise InputError(
                f"{path}: stores {columns} by {rows} pixels in one block of {block_bytes / 1e6:.0f} MB; write it "
                "again in tiles (gdal_translate -co TILED=YES)"
            )


@contextmanager
def _named_errors(path: str) -> Iterator[None]:
    """Turn GDAL's errors into an `InputError` that names the file."""
    try:
        yield
    except (RasterioError, UnicodeDecodeError) as error:  # the latter of messages that repeat the file
        reason = str(error.__cause__ or error).splitlines()[0].replace(f"{path}: ", "").rstrip(".")
        raise InputError(f"{path}: cannot be read as a raster, is it complete? ({reason})") from None


def read_heights(source: DatasetReader, window: Window, step: tuple[int, int] = (1, 1)) -> Array:
    """First band (h, w) in its own unit, NaN where there is no data; every `step`-th row and column.

    `step` = (1, 1) reads every pixel.
    """
    out_shape = (max(1, int(window.height) // step[0]), max(1, int(window.width) // step[1]))
    with _named_errors(source.name):
        band = source.read(1, window=window, out_shape=out_shape, masked=True)
    heights: Array = np.asarray(band.filled(0), dtype=np.float64) * source.scales[0] + source.offsets[0]
    heights[np.ma.getmaskarray(band) | ~np.isfinite(heights)] = np.nan
    return heights


def read_colours(source: DatasetReader, window: Window, step: tuple[int, int] = (1, 1)) -> tuple[Array32, Array32]:
    """Colours (h, w, 3) in the raster's own range and their validity (h, w), 1 or 0; every `step`-th row and column.

    Red, green and blue by their labels, else the first three bands; with fewer than three, the first as grey.
    """
    out_shape = (max(1, int(window.height) // step[0]), max(1, int(window.width) // step[1]))
    labels = source.colorinterp
    rgb_labels = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(label in labels for label in rgb_labels):
        bands = [labels.index(label) + 1 for label in rgb_labels]
    else:
        opaque = [k + 1 for k, label in enumerate(labels) if label != ColorInterp.alpha]
        bands = opaque[:3] if len(opaque) >= 3 else opaque[:1] * 3
    if not bands:
        raise InputError(f"{source.name}: the raster has no colour band, only transparency")
    with _named_errors(source.name):
        planes = source.read(sorted(set(bands)), window=window, out_shape=(len(set(bands)), *out_shape))
        valid = source.dataset_mask(window=window, out_shape=out_shape) > 0
    if has_palette(source):
        table = np.zeros((np.iinfo(planes.dtype).max + 1, 3))
        for index, colour in source.colormap(1).items():
            table[index] = colour[:3]
        colours = table[planes[0]].astype(np.float32)
    else:
        colours = np.stack([planes[sorted(set(bands)).index(band)] for band in bands], axis=-1).astype(np.float32)
    valid &= np.isfinite(colours).all(axis=-1)
    colours[~valid] = 0.0
    return colours, valid.astype(np.float32)


def has_palette(source: DatasetReader) -> bool:
    """Whether pixels are indices of a colour table, each 0 to 255."""
    return bool(source.colorinterp[0] == ColorInterp.palette and source.count <= 2)


def window_around(px: Array, shape: tuple[int, int], step: tuple[int, int]) -> Window | None:
    """Window of a raster of that shape, on whole blocks of `step`, around pixels (n, 2); None if they are outside."""
    px = np.clip(px[np.isfinite(px).all(axis=1)], -FARTHEST_PX, FARTHEST_PX)
    if not len(px):
        return None
    block = np.array([step[1], step[0]])
    low = np.maximum(np.floor(px.min(axis=0) / block).astype(int) - 2, 0) * block
    high = np.minimum((np.ceil(px.max(axis=0) / block).astype(int) + 2) * block, [shape[1], shape[0]])
    if (high <= low).any():
        return None
    columns, rows = (int(side) for side in high - low)
    return Window(int(low[0]), int(low[1]), columns, rows)


def block_mean(values: NDArray[Any], step: tuple[int, int]) -> NDArray[Any]:
    """Means of blocks of `step` (rows, columns); NaN in a block makes it NaN. An incomplete last block is left out."""
    if step == (1, 1):
        return values
    rows, columns = values.shape[0] // step[0], values.shape[1] // step[1]
    if not (rows and columns):
        step = min(step[0], values.shape[0]), min(step[1], values.shape[1])
        return block_mean(values, step)
    whole = values[: rows * step[0], : columns * step[1]]
    means: NDArray[Any] = whole.reshape(rows, step[0], columns, step[1], *values.shape[2:]).mean(axis=(1, 3))
    return means


def clipped(polygon: ArrayLike, low: Sequence[float], high: Sequence[float]) -> Array:
    """The part (m, 2) of a polygon (n, 2) between two corners of a rectangle; m = 0 when none is."""
    corners = [tuple(corner) for corner in np.asarray(polygon, dtype=np.float64) if np.isfinite(corner).all()]
    for axis, bound, sign in ((0, low[0], 1), (0, high[0], -1), (1, low[1], 1), (1, high[1], -1)):
        kept: list[tuple[float, ...]] = []
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            inside_a, inside_b = sign * (a[axis] - bound) >= 0, sign * (b[axis] - bound) >= 0
            if inside_a:
                kept.append(a)
            if inside_a != inside_b:
                t = (bound - a[axis]) / (b[axis] - a[axis])
                kept.append(tuple(p + t * (q - p) for p, q in zip(a, b, strict=True)))
        corners = kept
    return np.array(corners).reshape(-1, 2)


def _affine(transform: Affine, points: Array) -> Array:
    a, b, c, d, e, f = tuple(transform)[:6]
    return cast(Array, points @ np.array([[a, d], [b, e]]) + [c, f])
