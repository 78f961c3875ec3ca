# SPDX-License-Identifier: Apache-2.0
"""Pictures of the small world from above, placed exactly, as matchers get them."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from flight import encoded
from scene import Scene
from skymoor.geo.grid import Grid
from skymoor.types import Raster

Array = NDArray[np.float64]
Warping = Callable[[Array], Array]
"""Pixels (..., 2) of one picture to those of another."""

GRID = Grid(-84.0, 77.0, 0.8, (210, 250))


def seen_through(scene: Scene, grid_px_from_px: Warping, shape: tuple[int, int], *, grid: Grid = GRID) -> Raster:
    """A picture whose pixel p shows what lies at the pixel `grid_px_from_px(p)` of the grid; no noise.

    Heights are in pixels of the grid.
    """
    h, w = shape
    u, v = np.meshgrid((np.arange(3 * w) + 0.5) / 3, (np.arange(3 * h) + 0.5) / 3)
    plan = grid.enu_from_px(grid_px_from_px(np.stack([u, v], axis=-1)))
    colours = scene.colours_from_above(plan[..., 0], plan[..., 1])
    centre = plan[1::3, 1::3]
    heights = scene.heights(centre[..., 0], centre[..., 1]) / grid.pixel_m
    rgb = encoded(cv2.resize(colours, (w, h), interpolation=cv2.INTER_AREA))
    return Raster(rgb, np.ones(shape, bool), heights.astype(np.float32))


def another_day(raster: Raster, *, seed: int = 0, gamma: float = 0.75, noise_grey: float = 3.0) -> Raster:
    """Other radiometry and noise on colours and heights."""
    rng = np.random.default_rng(seed)
    grey = 20 + 0.85 * 255 * (raster.rgb / 255.0) ** gamma + rng.normal(scale=noise_grey, size=raster.rgb.shape)
    height = raster.height
    if height is not None:
        height = (height + rng.normal(scale=0.15, size=height.shape)).astype(np.float32)
    return Raster(np.clip(grey, 0, 255).astype(np.uint8), raster.mask, height)


def without_heights(raster: Raster) -> Raster:
    """Colours only."""
    return Raster(raster.rgb, raster.mask)


def noise_picture(shape: tuple[int, int], *, seed: int = 0, sigma_px: float = 2.0) -> NDArray[np.uint8]:
    """Smooth random colours (h, w, 3)."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(*shape, 1)).astype(np.float32), (0, 0), sigma_px)
    grey = 128 + 45 * smooth / smooth.std()
    return np.repeat(np.clip(grey, 1, 255)[..., None], 3, axis=-1).astype(np.uint8)
