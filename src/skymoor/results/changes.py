# SPDX-License-Identifier: Apache-2.0
"""What changed in height between a run and the earlier one that it was registered on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.features import shapes
from rasterio.io import MemoryFile
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT
from rasterio.warp import Resampling, transform_geom

from skymoor.engines.regular import regular
from skymoor.geo.accuracy import CE90_PER_SIGMA, LE90_PER_SIGMA
from skymoor.pipeline.options import MatchOptions
from skymoor.results.read import Result
from skymoor.results.report.renderings import difference_figure
from skymoor.results.report.scale import with_scale
from skymoor.store import Store
from skymoor.types import Array32, Image, Mask

FALSE_ALARM_SIGMAS = 3.29
"""Of a normal error: one pixel in a thousand that did not change lies beyond."""
NORMAL_MAD = 1.4826  # standard deviations of a normal distribution per median absolute deviation
LEAST_AREA_M2 = 4.0
"""Smaller areas are left out: errors of neighbouring pixels are correlated over about a metre."""
FAR_M = 1e6  # stands for unknown: no height is beyond
OUTLINE = (255, 176, 0)
DSM, CHANGES = "dsm.tif", "changes.geojson"
NAMES = ("change.tif", CHANGES, "matches/change.png")
KINDS = ("higher", "lower")


@dataclass(frozen=True, eq=False)
class HeightChanges:
    """Of two surfaces on one grid.

    Attributes:
        difference: (h, w) metres, later minus earlier, NaN where either is unknown.
        areas: (h, w) numbers of the changed areas, from 1; 0 where nothing changed.
        limit_m: heights that differ by less are not told apart.
        plan_m: by which edges may be displaced without being a change.
    """

    difference: Array32
    areas: NDArray[np.int32]
    limit_m: float
    plan_m: float


def height_changes(
    earlier: Array32, later: Array32, pixel_m: float, *, plan_sigma_m: float, height_sigma_m: float
) -> HeightChanges:
    """Areas whose heights differ by more than the error of the registration and the noise of both surfaces.

    A roof's edge that is displaced by the error of the registration is no change: a height counts by what it exceeds
    all heights of the other surface within CE90 and a pixel. What is left must exceed 3.29 standard deviations of
    registration and noise together, in an area of at least 4 m^2. The noise is the robust spread of the differences,
    which holds as long as less than half of the area changed.

    Args:
        earlier, later: heights (h, w) in metres, NaN where unknown.
        pixel_m: size of a pixel.
        plan_sigma_m, height_sigma_m: standard deviations of the registration of one on the other, per axis.
    """
    difference = np.asarray(later - earlier, np.float32)
    known = np.isfinite(difference)
    if not known.any():
        return HeightChanges(difference, np.zeros(difference.shape, np.int32), float("nan"), float("nan"))
    middle = float(np.median(difference[known]))
    noise = NORMAL_MAD * float(np.median(np.abs(difference[known] - middle)))
    limit_m = FALSE_ALARM_SIGMAS * float(np.hypot(noise, height_sigma_m))
    plan_m = CE90_PER_SIGMA * plan_sigma_m + pixel_m
    beyond = _beyond(earlier, later, max(1, round(plan_m / pixel_m)))
    changed = known & (np.abs(beyond) > limit_m)
    areas = np.zeros(difference.shape, np.int32)
    for sign in (1, -1):  # what was built and what was removed beside it are two areas
        _, labels, stats, _ = cv2.connectedComponentsWithStats((changed & (sign * beyond > 0)).astype(np.uint8))
        large = np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] * pixel_m**2 >= LEAST_AREA_M2) + 1
        numbers = np.zeros(len(stats), np.int32)
        numbers[large] = areas.max() + 1 + np.arange(len(large))
        areas += numbers[labels]
    return HeightChanges(difference, areas, limit_m, plan_m)


def _beyond(earlier: Array32, later: Array32, reach_px: int) -> Array32:
    """By how much (h, w) the heights differ that no displacement within reach explains, positive where later is higher.

    Each is compared with the range of the other nearby: one comparison keeps the whole of what was built or dug, the
    other of what was removed or filled.
    """
    ahead, back = _outside(earlier, later, reach_px), -_outside(later, earlier, reach_px)
    return np.asarray(np.where(np.abs(ahead) >= np.abs(back), ahead, back), np.float32)


def _outside(surface: Array32, height: Array32, reach_px: int) -> Array32:
    """By how much `height` (h, w) is above all of a surface nearby, or (negative) below all; 0 between, or unknown."""
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach_px + 1, 2 * reach_px + 1))
    known = np.isfinite(surface)
    highest = cv2.dilate(np.where(known, surface, -FAR_M).astype(np.float32), disk)
    lowest = cv2.erode(np.where(known, surface, FAR_M).astype(np.float32), disk)
    return np.asarray(np.nan_to_num(np.maximum(height - highest, 0) + np.minimum(height - lowest, 0)), np.float32)


def write_changes(result: Result, earlier: Path | None, store: Store) -> None:
    """`change.tif`, `changes.geojson` and a figure of a run on an `earlier` one, where both have heights.

    Heights below the run's `match.min_height_confidence` in either are unknown: where stereo fails, surfaces are
    interpolated, and two of them differ by metres.
    """
    for name in NAMES:
        store.remove(name)
    accuracy = _relative_accuracy(result)
    if earlier is None or accuracy is None or not all((one / DSM).is_file() for one in (earlier, result.folder)):
        return
    crs = result.frame.utm_zone  # metres, whatever the reference has
    with rasterio.open(result.folder / DSM) as raster, WarpedVRT(raster, crs=crs) as after:
        grid = {"transform": after.transform, "width": after.width, "height": after.height, "crs": crs}
    options = result.summary.get("options", {}).get("match", {})
    least = 100 * options.get("min_height_confidence", MatchOptions.min_height_confidence)
    was, is_now = (_confident_heights(folder, least, grid) for folder in (earlier, result.folder))
    sigmas = {"plan_sigma_m": accuracy[0] / CE90_PER_SIGMA, "height_sigma_m": accuracy[1] / LE90_PER_SIGMA}
    found = height_changes(was, is_now, grid["transform"].a, **sigmas)
    if not np.isfinite(found.limit_m):
        return
    store.write_bytes("change.tif", _geotiff(found.difference, grid["transform"], crs))
    store.write_json(CHANGES, _geojson(found, grid["transform"], crs))
    store.write_png("matches/change.png", _figure(found, grid["transform"].a))


def _confident_heights(folder: Path, least: float, grid: dict[str, Any]) -> Array32:
    """Heights (h, w) of a run on a grid, NaN where they are unknown or their confidence is below `least` percent."""
    with (
        rasterio.open(folder / DSM) as dsm,
        WarpedVRT(dsm, resampling=Resampling.bilinear, **grid) as heights,
    ):
        found = np.asarray(heights.read(1, masked=True).astype(np.float32).filled(np.nan), np.float32)
    if not (folder / "confidence.tif").is_file():  # runs of former versions have none
        return found
    with (
        rasterio.open(folder / "confidence.tif") as raster,
        WarpedVRT(raster, resampling=Resampling.nearest, **grid) as warped,
    ):
        percent = warped.read(1, masked=True).filled(0)
    return np.where(percent >= least, found, np.float32(np.nan))


def changes_words(folder: Path) -> str:
    """What `changes.geojson` of a run says, in one sentence; empty without it."""
    try:
        found = json.loads(regular(folder / CHANGES).read_text(encoding="utf-8"))
        areas = [one["properties"] for one in found["features"]]
        limit = f"by more than {found['limit_m']:.2f} m"
        volumes = {kind: sum(abs(one["volume_m3"]) for one in areas if one["kind"] == kind) for kind in KINDS}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""
    if not areas:
        return f"nothing changed since the earlier run {limit} in {LEAST_AREA_M2:.0f} m2 or more"
    told = " and ".join(f"{volume:.0f} m3 {kind}" for kind, volume in volumes.items() if volume)
    return f"{len(areas)} areas changed since the earlier run {limit}: {told}"


def _relative_accuracy(result: Result) -> tuple[float, float] | None:
    """Largest CE90 and LE90 of the registered surfaces without the reference's error, metres; None without any."""
    known = [one.summary["surface_accuracy"] for one in result.components if one.summary.get("surface_accuracy")]
    if not known:
        return None
    return max(one["relative_ce90_m"] for one in known), max(one["relative_le90_m"] for one in known)


def _geotiff(difference: Array32, transform: Affine, crs: str) -> bytes:
    with MemoryFile() as memory:
        height, width = difference.shape
        shape = {"width": width, "height": height, "count": 1, "dtype": "float32"}
        with memory.open(
            driver="COG", crs=crs, transform=transform, nodata=np.nan, compress="deflate", predictor="yes", **shape
        ) as raster:
            raster.write(difference, 1)
            raster.units = ["m"]
            raster.set_band_description(1, "height minus that of the earlier run")
        return bytes(memory.read())


def _geojson(found: HeightChanges, transform: Affine, crs: str) -> dict[str, Any]:
    """The changed areas in degrees (RFC 7946), with what changed in them."""
    features, pixel_m2 = [], abs(transform.a * transform.e)
    for outline, number in shapes(found.areas, found.areas > 0, connectivity=8, transform=transform):
        metres = found.difference[found.areas == int(number)].astype(np.float64)
        properties = {
            "kind": KINDS[bool(metres.mean() < 0)],
            "area_m2": len(metres) * pixel_m2,
            "mean_change_m": float(metres.mean()),
            "largest_change_m": float(metres[np.abs(metres).argmax()]),
            "volume_m3": float(metres.sum() * pixel_m2),
        }
        geometry = transform_geom(crs, "EPSG:4326", outline)
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    features.sort(key=lambda one: -abs(one["properties"]["volume_m3"]))
    return {"type": "FeatureCollection", "features": features, "limit_m": found.limit_m, "plan_m": found.plan_m}


def _figure(found: HeightChanges, pixel_m: float) -> Image:
    """The differences in height with the changed areas outlined, cut to where any is known, with scale and north."""
    rows, columns = np.nonzero(np.isfinite(found.difference))
    part = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    picture = np.ascontiguousarray(difference_figure(found.difference[part]))
    edges: Mask = found.areas[part] > 0
    outlines, _ = cv2.findContours(edges.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return with_scale(np.asarray(cv2.drawContours(picture, outlines, -1, OUTLINE, 2)), pixel_m)
