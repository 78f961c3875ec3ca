# SPDX-License-Identifier: Apache-2.0
"""Views rendered for matching (paper, section 3.1, NeRF reconstruction and rendering)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.model.protocol import SceneModel
from skymoor.types import Array, Progress, Render, View, no_progress

DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class RenderOptions:
    """Size and number of the renders.

    Attributes:
        max_px: largest long side of a render; its pixel is never finer than the photos' ground sampling distance.
        border_percent: percentage of the surface points that may lie outside, per side.
        obliques: number of oblique views, evenly spaced in azimuth.
        depression_deg: angle of the oblique views below the horizon, in degrees.
    """

    max_px: int = 2048
    border_percent: float = 0.3
    obliques: int = 8
    depression_deg: float = 45.0


def nadir_view(surface_points: Array, pixel: float, options: RenderOptions | None = None) -> View:
    """Nadir view with image x along x of the level frame and image y along -y.

    Args:
        surface_points: (n, 3) in the level frame; the view covers them except for a few outliers.
        pixel: ground sampling distance of the photos, level units.
    """
    return _covering_view(DOWN, surface_points, pixel, options or RenderOptions())


def oblique_views(surface_points: Array, pixel: float, options: RenderOptions | None = None) -> list[View]:
    """Oblique views from all sides (paper, section 3.4): by default eight, 45 degrees below the horizon.

    Args:
        surface_points: (n, 3) in the level frame; each view covers them except for a few outliers.
        pixel: ground sampling distance of the photos, level units.

    Returns:
        views ordered by viewing azimuth, from the level frame's y axis towards its x axis.
    """
    options = options or RenderOptions()
    azimuths = np.arange(options.obliques) * 360 / options.obliques
    return [_covering_view(_rotation(a, options.depression_deg), surface_points, pixel, options) for a in azimuths]


def render_nadir(
    model: SceneModel, options: RenderOptions | None = None, *, progress: Progress = no_progress
) -> Render:
    """Nadir render of the model; see `nadir_view`."""
    return model.render(nadir_view(model.surface_points, model.pixel, options), progress=progress)


def render_obliques(
    model: SceneModel, options: RenderOptions | None = None, *, progress: Progress = no_progress
) -> list[Render]:
    """Oblique renders of the model; see `oblique_views`."""
    renders = []
    views = oblique_views(model.surface_points, model.pixel, options)
    for view in views:
        renders.append(model.render(view, progress=no_progress))
        progress(len(renders), len(views))
    return renders


def tiles(shape: tuple[int, int], *, size: int = 300, overlap: float = 0.25) -> list[tuple[slice, slice]]:
    """Windows (rows, columns) of `size` pixels that share `overlap` with their neighbours (paper, section 3.4, tiling).

    The last tile of a row or column is shifted inwards, so that all have the same size; a smaller render is one tile.
    """
    step = max(round(size * (1 - overlap)), 1)
    starts = []
    for side in shape:
        count = max(int(np.ceil((side - size) / step)), 0) + 1
        starts.append([min(k * step, max(side - size, 0)) for k in range(count)])
    return [
        (slice(top, min(top + size, shape[0])), slice(left, min(left + size, shape[1])))
        for top in starts[0]
        for left in starts[1]
    ]


def _rotation(azimuth_deg: float, depression_deg: float) -> Array:
    """view_from_level (3, 3) of an upright view in the given direction."""
    azimuth, depression = np.radians([azimuth_deg, depression_deg])
    along = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    forward = np.cos(depression) * along - np.sin(depression) * np.array([0.0, 0.0, 1.0])
    return np.stack([right, np.cross(forward, right), forward])


def _covering_view(view_from_level: Array, surface_points: Array, pixel: float, options: RenderOptions) -> View:
    border = [options.border_percent, 100 - options.border_percent]
    low, high = np.percentile(surface_points @ view_from_level.T, border, axis=0)
    extent = (high - low)[:2]
    pixel = max(pixel, float(extent.max()) / options.max_px)
    shape = (int(np.ceil(extent[1] / pixel)), int(np.ceil(extent[0] / pixel)))
    return View(view_from_level, float(low[0]), float(low[1]), pixel, shape)
