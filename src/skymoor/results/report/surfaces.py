# SPDX-License-Identifier: Apache-2.0
"""Heights in the report: the shaded surface model, and its difference from the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from skymoor.geo import Grid
from skymoor.results.mosaic import Mosaic
from skymoor.results.report.figures import histogram
from skymoor.results.report.images import data_uri
from skymoor.results.report.maps import box_around, map_svg, raster_layer
from skymoor.results.report.renderings import difference_figure, height_figure, height_range
from skymoor.types import Array32, Image

MAP_PX = 900


@dataclass(frozen=True)
class Shaded:
    """The surface model as a map, and the heights at both ends and in the middle of its colours, in metres."""

    svg: Markup
    low: float
    middle: float
    high: float


def shaded_surface(mosaic: Mosaic, origin_m: float) -> Shaded | None:
    """Of the run's surface model; `origin_m` is the height of the site's origin above the ellipsoid."""
    height = mosaic.model_height
    if height is None or mosaic.grid is None or not np.isfinite(height).any():
        return None
    part, bounds = _known_part(height, mosaic.grid)
    low, high = height_range(part)
    label = f"Shaded surface model, north up, from {low + origin_m:.1f} to {high + origin_m:.1f} metres"
    svg = _map(height_figure(part), bounds, label)
    return Shaded(svg, low + origin_m, (low + high) / 2 + origin_m, high + origin_m)


def height_differences(mosaic: Mosaic) -> dict[str, Markup] | None:
    """Map and histogram of the model's heights minus those of the reference; None without both."""
    difference = mosaic.height_difference
    if difference is None or mosaic.grid is None:
        return None
    part, bounds = _known_part(difference, mosaic.grid)
    label = "Map of model height minus reference height, blue 3 metres too low, white equal, red 3 metres too high"
    svg = _map(difference_figure(part), bounds, label)
    return {"map": svg, "histogram": histogram(difference, "Model minus reference")}


def _known_part(values: Array32, grid: Grid) -> tuple[Array32, tuple[float, float, float, float]]:
    """What holds all known values (h, w), and its west, south, east and north."""
    rows, columns = np.nonzero(np.isfinite(values))
    top, bottom, left, right = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    (west, north), (east, south) = grid.enu_from_px([[left, top], [right, bottom]]).tolist()
    return values[top:bottom, left:right], (west, south, east, north)


def _map(rgb: Image, bounds: tuple[float, float, float, float], label: str) -> Markup:
    west, south, east, north = bounds
    box = box_around(np.array([[west, south], [east, north]]), margin=0.02)
    return map_svg(box, label, raster_layer(data_uri(rgb, MAP_PX), bounds))
