# SPDX-License-Identifier: Apache-2.0
"""The registered models from above on a grid of their own: colours, heights, and how far each pixel can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.errors import DegenerateGeometry
from skymoor.geo import Grid
from skymoor.geometry import Similarity
from skymoor.match.overlay import render_bounds, warp_confidence, warp_to_grid
from skymoor.pipeline.job import ComponentResult
from skymoor.results.formats import geotiffs, pointcloud_las
from skymoor.results.formats.raster import INTERPOLATED, UNKNOWN
from skymoor.store import Store
from skymoor.types import Array, Array32, Image, Mask, Progress, Reference, Render, no_progress

WORTH = 0.05  # confidence that widens the rasters; less is written within their bounds
MAX_PIXELS = 25e6
GROUND_STEP_PX = 3  # ground photos see the same wall often: a ninth of their pixels is enough for the cloud
HOLE_M2 = 1.0
"""Largest hole that is filled: larger ones are missing surfaces, which nobody should mistake for measured ones."""


@dataclass(frozen=True, eq=False)
class ModelRasters:
    """Colours (h, w, 3), ENU heights (h, w) in metres, NaN where unknown, and confidence (h, w) on `grid`."""

    grid: Grid
    rgb: Image
    height: Array32
    confidence: NDArray[np.uint8]


def model_rasters(
    items: Sequence[ComponentResult], *, max_pixels: float = MAX_PIXELS, progress: Progress = no_progress
) -> ModelRasters | None:
    """All registered components that were rendered from above; smaller ones fill what larger leave.

    The grid is as fine as the finest render, or as `max_pixels` allow, and no larger than what they cover. None without
    any.
    """
    shown = [(item.render, item.registration.enu_from_level) for item in items if item.registration.registered]
    views = [(render, transform) for render, transform in shown if render is not None and transform is not None]
    if not views:
        return None
    grid = _grid_of(views, max_pixels)
    rgb, height = np.zeros((*grid.shape, 3), np.uint8), np.full(grid.shape, np.nan, np.float32)
    confidence = np.full(grid.shape, UNKNOWN, np.uint8)
    for done, (render, transform) in enumerate(views):
        progress(done, len(views) + 1)
        warped, up = warp_to_grid(render, transform, grid, 0.0)
        fill = np.isnan(height) & np.isfinite(up) & warped.mask
        rgb[fill], height[fill] = warped.rgb[fill], up[fill]
        percent = np.clip(np.rint(100 * warp_confidence(render, transform, grid)), 1, 100)
        confidence[fill] = percent[fill].astype(np.uint8)
    progress(len(views), len(views) + 1)
    holes = small_holes(np.isfinite(height), HOLE_M2 / grid.pixel_m**2)
    if holes.any():
        rgb, height = _filled(rgb, height, holes, 0.5 * np.sqrt(HOLE_M2) / grid.pixel_m)
        confidence[holes] = INTERPOLATED
    progress(len(views) + 1, len(views) + 1)
    return ModelRasters(grid, rgb, height, confidence)


def _filled(rgb: Image, height: Array32, holes: Mask, sigma_px: float) -> tuple[Image, Array32]:
    """Colours and heights with Gaussian means of the known neighbours in the holes."""
    known = np.isfinite(height)
    middle = np.float32(np.nanmedian(height))
    layers = np.dstack([rgb, np.where(known, height - middle, 0)]).astype(np.float32) * known[..., None]
    total = cv2.GaussianBlur(layers, (0, 0), sigma_px)
    weight = np.maximum(cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma_px), 1e-6)
    mean = total[holes] / weight[holes][:, None]
    rgb, height = rgb.copy(), height.copy()
    rgb[holes], height[holes] = np.clip(mean[:, :3] + 0.5, 0, 255).astype(np.uint8), mean[:, 3] + middle
    return rgb, height


def small_holes(known: Mask, largest_px: float) -> Mask:
    """Unknown pixels (h, w) in areas of at most so many that known ones enclose."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~known).astype(np.uint8), connectivity=8)
    h, w = known.shape
    left, top, width, height, area = (stats[:, k] for k in range(5))
    enclosed = (left > 0) & (top > 0) & (left + width < w) & (top + height < h)
    wanted = enclosed & (area <= largest_px)
    wanted[0] = False  # the known pixels
    return np.asarray(wanted[labels])


def _grid_of(views: Sequence[tuple[Render, Similarity]], max_pixels: float) -> Grid:
    bounds = np.array([render_bounds(render, transform, WORTH) for render, transform in views])
    west, south = bounds[:, 0].min(), bounds[:, 1].min()
    east, north = bounds[:, 2].max(), bounds[:, 3].max()
    finest = min(transform.scale * render.view.pixel for render, transform in views)
    pixel = max(finest, float(np.sqrt((east - west) * (north - south) / max_pixels)))
    shape = max(1, int(np.ceil((north - south) / pixel))), max(1, int(np.ceil((east - west) / pixel)))
    return Grid(float(west), float(north), float(pixel), shape)


def write_rasters(
    components: Sequence[ComponentResult],
    reference: Reference,
    min_confidence: float,
    store: Store,
    progress: Progress,
) -> None:
    """pointcloud.laz, ortho.tif, dsm.tif and confidence.tif of all registered components with heights."""
    names = ("pointcloud.laz", "ortho.tif", "dsm.tif", "confidence.tif")
    components = [item for item in components if not item.flat]  # a plane is no surface
    rasters = model_rasters(components, progress=progress)
    try:
        cloud = pointcloud_las(*_cloud(components, min_confidence), reference.frame, reference.crs)
        if rasters is None:
            raise DegenerateGeometry("nothing was rendered from above")
        images = (rasters.rgb, rasters.height, rasters.confidence)
        contents = (cloud, *geotiffs(*images, rasters.grid, reference.frame, reference.crs))
    except DegenerateGeometry:
        for name in names:
            store.remove(name)
        return
    for name, content in zip(names, contents, strict=True):
        store.write_bytes(name, content)


def _cloud(components: Sequence[ComponentResult], min_confidence: float) -> tuple[Array, Image]:
    """Points (n, 3) ENU and colours (n, 3): of the renders where they are confident, and of ground depth maps."""
    clouds, colours = [], []
    for item in components:
        transform = item.registration.enu_from_level
        if not item.registration.registered or transform is None:
            continue
        if item.render is None:
            for xyz_level, rgb in (depth_map.points(step=GROUND_STEP_PX) for depth_map in item.depths):
                clouds.append(transform.apply(xyz_level.astype(np.float64)))
                colours.append(rgb)
            continue
        confident = item.render.confidence >= min_confidence
        clouds.append(transform.apply(item.render.xyz[confident].astype(np.float64)))
        colours.append(item.render.rgb[confident])
    if not clouds:
        raise DegenerateGeometry("nothing is registered")
    return np.concatenate(clouds), np.concatenate(colours)
