# SPDX-License-Identifier: Apache-2.0
"""Pictures of the small world from above, placed exactly, as matchers get them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.geo import Grid
from skymoor.simulate.light.scene import Scene
from skymoor.types import Raster
from support.flight import as_colours, seen_from_above

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Warping = Callable[[Array], Array]
"""Pixels (..., 2) of one picture to those of another."""

GRID = Grid(-100.0, 84.0, 0.8, (210, 250))
FINE = Grid(GRID.east0 - 10, GRID.north0 + 10, 0.2, (940, 1100))  # with a margin for pictures that lie across the edge


@dataclass(frozen=True, eq=False)
class Overhead:
    """What a scene looks like from straight above: light (h, w, 3) and heights (h, w) in metres, on `FINE`."""

    light: Array32
    height: Array32

    def light_at(self, plan: ArrayLike) -> Array32:
        """Light (h, w, 3) at plan positions (h, w, 2)."""
        return _at(self.light, plan)

    def heights_at(self, plan: ArrayLike) -> Array32:
        """Heights (h, w) in metres at plan positions (h, w, 2)."""
        return _at(self.height, plan)


def overhead(scene: Scene, *, east_m: float = 0.0) -> Overhead:
    """Of a scene, or of what lies so far east in it."""
    plan = FINE.centres() + [east_m, 0.0]
    return Overhead(*seen_from_above(scene, plan[..., 0], plan[..., 1], pixel_m=FINE.pixel_m))


def seen_through(view: Overhead, grid_px_from_px: Warping, shape: tuple[int, int], *, grid: Grid = GRID) -> Raster:
    """A picture whose pixel p shows what lies at the pixel `grid_px_from_px(p)` of the grid; no noise.

    Heights are in pixels of the grid.
    """
    h, w = shape
    u, v = np.meshgrid((np.arange(3 * w) + 0.5) / 3, (np.arange(3 * h) + 0.5) / 3)
    plan = grid.enu_from_px(grid_px_from_px(np.stack([u, v], axis=-1)))
    rgb = as_colours(cv2.resize(view.light_at(plan), (w, h), interpolation=cv2.INTER_AREA))
    return Raster(rgb, np.ones(shape, bool), view.heights_at(plan[1::3, 1::3]) / np.float32(grid.pixel_m))


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


def _at(values: Array32, plan: ArrayLike) -> Array32:
    """Values on `FINE` between its pixels; those beyond its border are the border's."""
    u, v = np.moveaxis(FINE.px_from_enu(plan).astype(np.float32) - np.float32(0.5), -1, 0)
    return np.asarray(cv2.remap(values, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
