# SPDX-License-Identifier: Apache-2.0
"""The reference: a satellite orthophoto and its DSM, resampled to one north-up grid in local metres."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rasterio.io import DatasetReader
from rasterio.windows import Window

from skymoor.errors import InputError
from skymoor.geo import EnuFrame, Grid, checked_covariance, sample
from skymoor.geo.datum import Heights, ellipsoid_from_datum, same_vertical_datum
from skymoor.reference.raster import (
    MapRaster,
    block_mean,
    clipped_to_raster,
    has_palette,
    opened,
    read_colours,
    read_heights,
    window_around,
)
from skymoor.reference.resample import SAMPLES, Cut, Lattice
from skymoor.types import Image, Mask, Progress, Reference, no_progress

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

TILE_PX = 1024
# Largest side of the window of a source that one tile reads, in pixels: it bounds the memory.
WINDOW_PX = 2048
# Pixels of one source in the overlap; they take ten minutes to read.
LARGEST_OVERLAP_PX = 4e9
# Heights on Earth, with a margin for geoid and towers; beyond are feet, centimetres or an undeclared nodata value.
HEIGHT_RANGE_M = (-1000.0, 10000.0)
MIN_SIDE_PX = 8
STRETCH_PERCENT = (1.0, 99.0)
STATISTICS_PX = 1000


def read_reference(
    ortho: Path,
    dsm: Path,
    vertical_datum: str | None,
    covariance: ArrayLike,
    *,
    max_pixels: float = 40e6,
    pixel_m: float | None = None,
    progress: Progress = no_progress,
) -> Reference:
    """Read an orthophoto and a DSM, each in any CRS, into one grid in the local frame at the centre of their overlap.

    `vertical_datum` is the datum of the DSM's heights ("ellipsoid" or a vertical CRS such as "EPSG:3855"); None
    takes it from the DSM's CRS. `covariance` (3, 3) is the reference's accuracy in m^2, east-north-up. The grid's
    pixel is the orthophoto's, or `pixel_m` if that is coarser, and larger if needed to stay below `max_pixels`. Sources
    are read tile by tile, so that memory depends on `max_pixels` and not on their size (docs/limits.md).
    Raises `InputError`, one line that names the file and the remedy, for every fault of the input.
    """
    covariance = checked_covariance(covariance)
    if Path(ortho).exists() and Path(dsm).exists() and Path(ortho).samefile(dsm):
        raise InputError(f"{dsm}: is given both as the orthophoto and as its DSM; give two files")
    maps = MapRaster.of(Path(ortho)), MapRaster.of(Path(dsm))
    datum = _agreed_datum(maps[1], vertical_datum)
    overlap = _overlap(*maps)
    with ExitStack() as stack:
        sources = stack.enter_context(opened(maps[0].path)), stack.enter_context(opened(maps[1].path))
        _require_heights(sources[1], maps[1].path)
        for raster in maps:
            _require_readable_size(raster, overlap)
        site = _Site.of(maps, overlap, sources[1], datum)
        grid = site.grid(maps[0], overlap, max_pixels, pixel_m)
        rgb, mask, height = _resampled(sources, maps, site, grid, progress)
    _require_data(maps, mask, np.isfinite(height))
    sides = maps[1].pixel_sides_m(site.frame)
    dsm_pixel_m = float(np.sqrt(abs(np.linalg.det(sides))))
    return Reference(site.frame, grid, rgb, mask, height, covariance, dsm_pixel_m, maps[0].crs.to_wkt())


def _resampled(
    sources: tuple[DatasetReader, DatasetReader],
    maps: tuple[MapRaster, MapRaster],
    site: _Site,
    grid: Grid,
    progress: Progress,
) -> tuple[Image, Mask, Array32]:
    """Colours, where they are valid, and heights of the whole grid, tile by tile."""
    stretch = _stretch(sources[0], maps[0])
    rgb, mask = np.zeros((*grid.shape, 3), np.uint8), np.zeros(grid.shape, bool)
    height = np.full(grid.shape, np.nan, np.float32)
    tiles = list(_tiles(grid.shape, _tile_px(maps, site.frame, grid)))
    for done, (rows, columns) in enumerate(tiles):
        progress(done, len(tiles))
        lattice = Lattice.of(grid, rows, columns, site.frame)
        rgb[rows, columns], mask[rows, columns] = _colour_tile(sources[0], maps[0], lattice, stretch)
        height[rows, columns] = _height_tile(sources[1], maps[1], lattice, site)
    progress(len(tiles), len(tiles))
    return rgb, mask, height


def _agreed_datum(dsm: MapRaster, stated: str | None) -> str:
    if stated is None and dsm.vertical_datum is None:
        raise InputError(
            f"{dsm.path}: nothing says which vertical datum its heights have; set reference.vertical_datum to "
            '"ellipsoid" or to the EPSG code of a vertical CRS, such as "EPSG:3855"'
        )
    if stated is not None and dsm.vertical_datum is not None and not same_vertical_datum(stated, dsm.vertical_datum):
        raise InputError(
            f"{dsm.path}: its coordinate reference system says heights are {dsm.vertical_datum}, but "
            f"reference.vertical_datum is {stated}; correct one of them"
        )
    datum = stated if dsm.vertical_datum is None else dsm.vertical_datum
    assert datum is not None
    return datum


def _overlap(ortho: MapRaster, dsm: MapRaster) -> Array:
    """Outline (n, 2) of the common area in longitude and latitude."""
    border = ortho.lonlat_from_px(ortho.border_px())
    polygon = clipped_to_raster(dsm.px_from_lonlat(border), dsm)
    if len(polygon) < 3:
        raise InputError(f"orthophoto and DSM do not overlap: {ortho.extent()}; {dsm.extent()}; check both files")
    # The corners after clipping are far apart, and straight lines in one CRS are curves in another.
    t = np.arange(8)[:, None, None] / 8
    dense = polygon * (1 - t) + np.roll(polygon, -1, axis=0) * t
    return dsm.lonlat_from_px(dense.transpose(1, 0, 2).reshape(-1, 2))


@dataclass(frozen=True, eq=False)
class _Site:
    """The local frame, and the conversion of the DSM's heights to metres in it."""

    frame: EnuFrame
    heights: Heights
    dsm_unit_m: float

    @classmethod
    def of(cls, maps: tuple[MapRaster, MapRaster], overlap: Array, source: DatasetReader, datum: str) -> _Site:
        """Frame at the centre of the overlap, at the median height there."""
        start = EnuFrame(overlap[0, 1], overlap[0, 0], 0.0)
        outline = start.enu_from_lla(overlap[:, 1], overlap[:, 0], 0.0)[:, :2]
        middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
        lat, lon, _ = (float(value) for value in start.lla_from_enu([*middle, 0.0])[0])
        window = window_around(maps[1].px_from_lonlat(overlap), maps[1].shape, (1, 1))
        assert window is not None  # the overlap is a part of the DSM
        step = max(1, int(window.height) // STATISTICS_PX), max(1, int(window.width) // STATISTICS_PX)
        heights = read_heights(source, window, step)
        if not np.isfinite(heights).any():
            raise InputError(
                f"{maps[1].path}: no valid height where it overlaps the orthophoto (nodata is {source.nodata}); "
                "check the file"
            )
        to_ellipsoid = ellipsoid_from_datum(datum, overlap[:, 1], overlap[:, 0])
        at_zero, at_1000 = to_ellipsoid(lat, lon, [0.0, 1000.0])
        unit = float(at_1000 - at_zero) / 1000.0
        if str(source.units[0]).lower().startswith(("f", "us survey f")) and unit > 0.99:
            raise InputError(
                f"{maps[1].path}: its band has heights in {source.units[0]}, its vertical datum is in metres; "
                "convert the heights, or state a vertical CRS in feet"
            )
        _require_plausible(maps[1].path, heights, unit)
        return cls(EnuFrame(lat, lon, float(at_zero + unit * np.nanmedian(heights))), to_ellipsoid, unit)

    def grid(self, ortho: MapRaster, overlap: Array, max_pixels: float, pixel_m: float | None) -> Grid:
        """North-up grid of the overlap's bounding box."""
        outline = self.frame.enu_from_lla(overlap[:, 1], overlap[:, 0], self.frame.height_m)[:, :2]
        (west, south), (east, north) = outline.min(axis=0), outline.max(axis=0)
        own = float(np.sqrt(abs(np.linalg.det(ortho.pixel_sides_m(self.frame)))))
        pixel = max(own, pixel_m or 0.0, float(np.sqrt((east - west) * (north - south) / max_pixels)))
        shape = round((north - south) / pixel), round((east - west) / pixel)
        if min(shape) < MIN_SIDE_PX:
            raise InputError(
                f"{ortho.path}: its overlap with the DSM is only {east - west:.1f} m by {north - south:.1f} m, "
                f"{shape[1]} by {shape[0]} pixels; check both files"
            )
        return Grid(float(west), float(north), pixel, (int(shape[0]), int(shape[1])))


def _colour_tile(
    source: DatasetReader, raster: MapRaster, lattice: Lattice, stretch: Callable[[Array32], Array32]
) -> tuple[Image, Mask]:
    cut = Cut.of(raster, lattice)
    if cut is None:
        return np.zeros((*lattice.shape, 3), np.uint8), np.zeros(lattice.shape, bool)
    colours, valid = read_colours(source, cut.window, cut.thin)
    # Colours are weighted by their validity, so that nodata does not darken the border.
    weighted = np.concatenate([stretch(colours) * valid[..., None], valid[..., None]], axis=-1)
    map_u, map_v = (np.nan_to_num(p - 0.5, nan=-9.0).astype(np.float32) for p in (cut.u, cut.v))
    blocks = block_mean(weighted, cut.step)
    # The nearest block is extrapolated by half its size; pixels outside the raster are masked below.
    mixed = cv2.remap(blocks, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (cut.u >= 0) & (cut.v >= 0) & (cut.u <= blocks.shape[1]) & (cut.v <= blocks.shape[0])
    mask = (mixed[..., 3] >= 0.5) & inside
    rgb = np.where(mask[..., None], mixed[..., :3] / np.maximum(mixed[..., 3:], 0.5), 0.0)
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8), mask


def _height_tile(source: DatasetReader, raster: MapRaster, lattice: Lattice, site: _Site) -> Array32:
    cut = Cut.of(raster, lattice)
    if cut is None:
        return np.full(lattice.shape, np.nan, np.float32)
    heights = read_heights(source, cut.window, cut.thin)
    _require_plausible(raster.path, heights, site.dsm_unit_m)
    # OpenCV rounds its weights to 1/32 pixel, too coarse for heights.
    own = sample(block_mean(heights, cut.step), np.column_stack([cut.u.ravel(), cut.v.ravel()]))
    lat, lon, level = lattice.lla.T
    # The geoid minus the height of the plane up = 0, which bends away from the ellipsoid, is smooth.
    up_of_zero = lattice.spread(site.heights(lat, lon, np.zeros(len(lat))) - level)
    return (own.reshape(lattice.shape) * site.dsm_unit_m + up_of_zero).astype(np.float32)


def _tile_px(maps: tuple[MapRaster, MapRaster], frame: EnuFrame, grid: Grid) -> int:
    finest = min(float(np.linalg.norm(raster.pixel_sides_m(frame), axis=1).min()) for raster in maps)
    # A cut reads every pixel up to twice as many as it needs, and subsamples beyond.
    samples = min(grid.pixel_m / finest, 2.0 * SAMPLES)
    return int(np.clip(WINDOW_PX / samples, 32, TILE_PX))


def _tiles(shape: tuple[int, int], side: int) -> Iterator[tuple[slice, slice]]:
    for top in range(0, shape[0], side):
        for left in range(0, shape[1], side):
            yield slice(top, min(top + side, shape[0])), slice(left, min(left + side, shape[1]))


def _stretch(source: DatasetReader, raster: MapRaster) -> Callable[[Array32], Array32]:
    """The stretch to 0..255: none for 8 bits, else linear over the middle 98 % of all valid values of all bands."""
    if has_palette(source) or all(kind == "uint8" for kind in source.dtypes):
        return lambda colours: colours
    rows, columns = raster.shape
    step = max(1, rows // STATISTICS_PX), max(1, columns // STATISTICS_PX)
    colours, valid = read_colours(source, Window(0, 0, columns, rows), step)
    if not valid.any():
        raise InputError(f"{raster.path}: the orthophoto has no valid pixel; check its nodata value and mask")
    low, high = (float(value) for value in np.percentile(colours[valid > 0], STRETCH_PERCENT))
    gain = 255.0 / max(high - low, 1e-12)
    return lambda colours: np.clip((colours - low) * gain, 0.0, 255.0).astype(np.float32)


def _require_heights(source: DatasetReader, path: Path) -> None:
    if source.count >= 3 and all(kind == "uint8" for kind in source.dtypes):
        raise InputError(f"{path}: has {source.count} bands of 8 bits: an image, not heights; is it the orthophoto?")
    scale, offset = source.scales[0], source.offsets[0]
    if not (np.isfinite(scale) and np.isfinite(offset)) or scale == 0:
        raise InputError(
            f"{path}: its band has scale {scale:g} and offset {offset:g}; correct them (gdal_edit -scale -offset)"
        )


def _require_readable_size(raster: MapRaster, overlap: Array) -> None:
    window = window_around(raster.px_from_lonlat(overlap), raster.shape, (1, 1))
    if window is not None and window.width * window.height > LARGEST_OVERLAP_PX:
        raise InputError(
            f"{raster.path}: {window.width} by {window.height} of its pixels are in the overlap of orthophoto and DSM, "
            f"at most {LARGEST_OVERLAP_PX:g} are read; crop it to the site (gdal_translate -projwin)"
        )


def _require_plausible(path: Path, heights: Array, unit_m: float) -> None:
    metres = heights[np.isfinite(heights)] * unit_m
    impossible = metres[(metres < HEIGHT_RANGE_M[0]) | (metres > HEIGHT_RANGE_M[1])]
    if impossible.size:
        raise InputError(
            f"{path}: {impossible.size} heights are impossible, such as {impossible[0] / unit_m:g}; declare that "
            "nodata value (gdal_edit -a_nodata), or convert the heights to metres"
        )


def _require_data(maps: tuple[MapRaster, MapRaster], mask: Mask, known: Mask) -> None:
    if not mask.any():
        raise InputError(f"{maps[0].path}: no valid pixel where it overlaps the DSM; check its nodata value and mask")
    if not known.any():
        raise InputError(f"{maps[1].path}: no valid height where it overlaps the orthophoto; check its nodata value")
    if not (mask & known).any():
        raise InputError(f"{maps[0].path}: none of its valid pixels has a valid height in {maps[1].path}; check both")
