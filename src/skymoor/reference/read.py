# SPDX-License-Identifier: Apache-2.0
"""The reference: a satellite orthophoto and heights of the ground, resampled to one north-up grid in local metres."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rasterio.io import DatasetReader

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_HEIGHT_SIGMA_M, EnuFrame, Grid, checked_covariance
from skymoor.geo.operations import accuracy_note, horizontal_operation
from skymoor.reference.heights import Dsm, Ground, NoHeights, OneHeight, agreed_datum
from skymoor.reference.own_pixels import stretch_of
from skymoor.reference.raster import (
    MapRaster,
    block_mean,
    clipped,
    opened,
    read_colours,
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
MIN_SIDE_PX = 8
SMALLEST_PIXEL_M = 1e-9
UNKNOWN_ACCURACY_NOTE = (
    "its accuracy is stated to be unknown, so what is registered to it has an accuracy relative to it alone, and "
    "no CE90 and LE90 on Earth"
)


def read_reference(
    ortho: Path,
    dsm: Path | float | None,
    vertical_datum: str | None,
    covariance: ArrayLike,
    *,
    max_pixels: float = 40e6,
    pixel_m: float | None = None,
    area: Sequence[float] | None = None,
    progress: Progress = no_progress,
) -> Reference:
    """Read an orthophoto and a DSM, each in any CRS, into one grid in the local frame at the centre of their overlap.

    In place of a DSM there may be one height in metres, or None where nothing is known of heights; the grid then
    covers the orthophoto. `vertical_datum` is the datum of the heights ("ellipsoid" or a vertical CRS such as
    "EPSG:3855"); None takes it from the DSM's CRS. `covariance` (3, 3) is the reference's accuracy in m^2,
    east-north-up, or `UNKNOWN_ACCURACY`; the errors of PROJ's transformations are added to it, and `Reference.notes`
    say so. The grid's pixel is the orthophoto's, or `pixel_m` if that is coarser, and larger if needed to stay below
    `max_pixels`. Sources are read tile by tile, so that memory depends on `max_pixels` and not on their size
    (docs/limits.md). `area`, (west, south, east, north) in degrees, leaves out what lies beyond.
    Raises `InputError`, one line that names the file and the remedy, for every fault of the input.
    """
    stated = np.asarray(covariance, dtype=np.float64)
    covariance = stated if np.isnan(stated).all() else checked_covariance(covariance)
    maps = _maps(ortho, dsm)
    outline = _outline(maps, area)
    with _opened(maps, dsm, vertical_datum, outline) as (source, ground):
        frame = _frame(outline, ground)
        grid = _grid(frame, maps[0], outline, max_pixels, pixel_m)
        rgb, mask, height = _resampled(source, maps, ground, frame, grid, progress)
        _require_data(maps, mask, np.isfinite(height))
        total, notes = _accuracy(covariance, maps, ground, frame)
        finest_m = max(maps[0].pixel_m(frame), pixel_m or 0.0)
    crs, dsm_pixel_m = maps[0].crs.to_wkt(), ground.pixel_m(frame)
    found = Reference(frame, grid, rgb, mask, height, total, dsm_pixel_m, crs, notes, finest_m)
    return replace(found, notes=(*notes, _detail_lost(maps[0], grid.pixel_m, finest_m))) if found.detail_lost else found


def read_part(
    ortho: Path,
    dsm: Path | float | None,
    vertical_datum: str | None,
    frame: EnuFrame,
    bounds_m: Sequence[float],
    pixel_m: float,
) -> tuple[Grid, Image, Mask, Array32]:
    """The grid of a part of a reference with its colours, where they are valid, and heights, at any pixel.

    `ortho`, `dsm` and `vertical_datum` are those of a reference that was read, and checked, in `frame`; `bounds_m` are
    west, south, east and north in it. Raises `InputError` where the files cannot be read.
    """
    maps, (west, south, east, north) = _maps(ortho, dsm), bounds_m
    shape = (max(1, round((north - south) / pixel_m)), max(1, round((east - west) / pixel_m)))
    grid = Grid(float(west), float(north), pixel_m, shape)
    with _opened(maps, dsm, vertical_datum, _outline(maps), Dsm.unchecked) as (source, ground):
        return grid, *_resampled(source, maps, ground, frame, grid, no_progress)


def _maps(ortho: Path, dsm: Path | float | None) -> list[MapRaster]:
    """The rasters of a reference: the orthophoto, and the DSM where it is one."""
    colours = MapRaster.of(Path(ortho))
    return [colours] if dsm is None or isinstance(dsm, int | float) else [colours, _another(colours.path, Path(dsm))]


def _outline(maps: Sequence[MapRaster], area: Sequence[float] | None = None) -> Array:
    """Outline (n, 2) in longitude and latitude of what all rasters cover, and of that the part in `area`."""
    outline = _overlap(*maps) if len(maps) == 2 else maps[0].lonlat_from_px(maps[0].border_px())
    if area is not None:
        outline = clipped(outline, area[:2], area[2:])
        if len(outline) < 3:
            west, south, east, north = area
            raise InputError(
                f"the area (latitude {south:g} to {north:g}, longitude {west:g} to {east:g}) has nothing in common "
                f"with the reference: {maps[0].extent()}; check --area or --near, and the orthophoto"
            )
    _require_readable_size(maps, outline)
    return outline


@contextmanager
def _opened(
    maps: Sequence[MapRaster],
    dsm: Path | float | None,
    vertical_datum: str | None,
    outline: Array,
    dsm_of: Callable[[MapRaster, DatasetReader, str, Array], Dsm] = Dsm.of,
) -> Iterator[tuple[DatasetReader, Ground]]:
    """The open orthophoto, and what says how high the ground is."""
    with ExitStack() as stack:
        ground: Ground
        if len(maps) == 2:
            datum = agreed_datum(maps[1], vertical_datum)
            ground = dsm_of(maps[1], stack.enter_context(opened(maps[1].path)), datum, outline)
        elif isinstance(dsm, int | float):
            ground = OneHeight.of(float(dsm), vertical_datum, outline)
        else:
            ground = NoHeights.beside(maps[0].path)
        yield stack.enter_context(opened(maps[0].path)), ground


def _detail_lost(ortho: MapRaster, pixel_m: float, finest_m: float) -> str:
    return (
        f"{ortho.path}: has pixels of {finest_m:.2g} m, but its area is so large that places are searched at "
        f"{pixel_m:.2g} m; those that are found are read again at {finest_m:.2g} m. If you know the area, --area or "
        "--near searches it in all detail"
    )


def _another(ortho: Path, dsm: Path) -> MapRaster:
    if dsm.exists() and ortho.samefile(dsm):
        raise InputError(f"{dsm}: is given both as the orthophoto and as its DSM; give two files")
    return MapRaster.of(dsm)


def _overlap(ortho: MapRaster, dsm: MapRaster) -> Array:
    """Outline (n, 2) of the common area in longitude and latitude."""
    border = ortho.lonlat_from_px(ortho.border_px())
    polygon = clipped(dsm.px_from_lonlat(border), (0, 0), dsm.shape[::-1])
    if len(polygon) < 3:
        raise InputError(f"orthophoto and DSM do not overlap: {ortho.extent()}; {dsm.extent()}; check both files")
    # The corners after clipping are far apart, and straight lines in one CRS are curves in another.
    t = np.arange(8)[:, None, None] / 8
    dense = polygon * (1 - t) + np.roll(polygon, -1, axis=0) * t
    return dsm.lonlat_from_px(dense.transpose(1, 0, 2).reshape(-1, 2))


def _frame(outline: Array, ground: Ground) -> EnuFrame:
    """At the centre of the outline (n, 2), at the height of the ground there."""
    start = EnuFrame(outline[0, 1], outline[0, 0], 0.0)
    plan = start.enu_from_lla(outline[:, 1], outline[:, 0], 0.0)[:, :2]
    middle = (plan.min(axis=0) + plan.max(axis=0)) / 2
    lat, lon, _ = (float(value) for value in start.lla_from_enu([*middle, 0.0])[0])
    return EnuFrame(lat, lon, ground.middle_m(lat, lon))


def _grid(frame: EnuFrame, ortho: MapRaster, outline: Array, max_pixels: float, pixel_m: float | None) -> Grid:
    """North-up grid of the outline's bounding box."""
    plan = frame.enu_from_lla(outline[:, 1], outline[:, 0], frame.height_m)[:, :2]
    (west, south), (east, north) = plan.min(axis=0), plan.max(axis=0)
    pixel = max(ortho.pixel_m(frame), pixel_m or 0.0, float(np.sqrt((east - west) * (north - south) / max_pixels)))
    if not (np.isfinite(pixel) and np.isfinite(plan).all()):
        raise InputError(
            f"{ortho.path}: its position is outside the area of its coordinate reference system; check both"
        )
    shape = round((north - south) / pixel), round((east - west) / pixel)
    if min(shape) < MIN_SIDE_PX:
        raise InputError(
            f"{ortho.path}: the area of the reference is only {east - west:.1f} m by {north - south:.1f} m, "
            f"{shape[1]} by {shape[0]} pixels; check the orthophoto and its overlap with the DSM"
        )
    return Grid(float(west), float(north), pixel, (int(shape[0]), int(shape[1])))


def _resampled(
    source: DatasetReader,
    maps: Sequence[MapRaster],
    ground: Ground,
    frame: EnuFrame,
    grid: Grid,
    progress: Progress,
) -> tuple[Image, Mask, Array32]:
    """Colours, where they are valid, and heights of the whole grid, tile by tile."""
    stretch = stretch_of(source, maps[0])
    rgb, mask = np.zeros((*grid.shape, 3), np.uint8), np.zeros(grid.shape, bool)
    height = np.full(grid.shape, np.nan, np.float32)
    tiles = list(_tiles(grid.shape, _tile_px(maps, frame, grid)))
    for done, (rows, columns) in enumerate(tiles):
        progress(done, len(tiles))
        lattice = Lattice.of(grid, rows, columns, frame)
        rgb[rows, columns], mask[rows, columns] = _colour_tile(source, maps[0], lattice, stretch)
        height[rows, columns] = ground.tile(lattice)
    progress(len(tiles), len(tiles))
    return rgb, mask, height


def _accuracy(
    covariance: Array, maps: Sequence[MapRaster], ground: Ground, frame: EnuFrame
) -> tuple[Array, tuple[str, ...]]:
    """The covariance (3, 3) with the errors of PROJ's transformations, and all notes about the reference.

    Of two rasters the less accurate transformation counts: colours and heights have to lie on each other.
    """
    different = [raster for k, raster in enumerate(maps) if raster.crs not in [other.crs for other in maps[:k]]]
    plan = [(raster, horizontal_operation(raster.crs, frame.lon_deg, frame.lat_deg)) for raster in different]
    notes = [accuracy_note(operation, str(raster.path)) for raster, operation in plan]
    notes.append(accuracy_note(ground.to_ellipsoid.operation, "vertical datum"))
    sigmas = [operation.sigma_m for _, operation in plan]
    total = covariance + np.diag([max(sigmas) ** 2, max(sigmas) ** 2, ground.to_ellipsoid.operation.sigma_m**2])
    if isinstance(ground, NoHeights):
        total[2, :] = total[:, 2] = 0.0
        total[2, 2] = UNKNOWN_HEIGHT_SIGMA_M**2
    if np.isnan(covariance).all():
        notes.append(f"{maps[0].path}: {UNKNOWN_ACCURACY_NOTE}")
    return total, (*ground.notes, *filter(None, notes))


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


def _tile_px(maps: Sequence[MapRaster], frame: EnuFrame, grid: Grid) -> int:
    finest = min(float(np.linalg.norm(raster.pixel_sides_m(frame), axis=1).min()) for raster in maps)
    if not SMALLEST_PIXEL_M < finest < np.inf:
        raise InputError(f"{maps[0].path}: its pixels have no size on the ground; check the geotransform or world file")
    # A cut reads every pixel up to twice as many as it needs, and subsamples beyond.
    samples = min(grid.pixel_m / finest, 2.0 * SAMPLES)
    return int(np.clip(WINDOW_PX / samples, 32, TILE_PX))


def _tiles(shape: tuple[int, int], side: int) -> Iterator[tuple[slice, slice]]:
    for top in range(0, shape[0], side):
        for left in range(0, shape[1], side):
            yield slice(top, min(top + side, shape[0])), slice(left, min(left + side, shape[1]))


def _require_readable_size(maps: Sequence[MapRaster], outline: Array) -> None:
    for raster in maps:
        window = window_around(raster.px_from_lonlat(outline), raster.shape, (1, 1))
        if window is not None and window.width * window.height > LARGEST_OVERLAP_PX:
            raise InputError(
                f"{raster.path}: {window.width} by {window.height} of its pixels are in the area of the reference, "
                f"at most {LARGEST_OVERLAP_PX:g} are read; crop it to the site (gdal_translate -projwin)"
            )


def _require_data(maps: Sequence[MapRaster], mask: Mask, known: Mask) -> None:
    if not mask.any():
        raise InputError(
            f"{maps[0].path}: no valid pixel in the area of the reference; check its nodata value and mask"
        )
    if len(maps) == 1:
        return
    if not known.any():
        raise InputError(f"{maps[1].path}: no valid height where it overlaps the orthophoto; check its nodata value")
    if not (mask & known).any():
        raise InputError(f"{maps[0].path}: none of its valid pixels has a valid height in {maps[1].path}; check both")
