# SPDX-License-Identifier: Apache-2.0
"""The views that are rendered for matching (paper, section 3.1, NeRF reconstruction and rendering)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.types import Array, View


@dataclass(frozen=True)
class RenderOptions:
    """Size of the renders.

    Attributes:
        max_px: long side of a render; its pixel is never finer than a photo's pixel on the ground.
        border_percent: share of the surface points that may lie outside, per side.
    """

    max_px: int = 2048
    border_percent: float = 0.3


def nadir_view(surface_points: Array, pixel: float, options: RenderOptions | None = None) -> View:
    """Straight down, x of the picture along x of the level frame, y along -y.

    Args:
        surface_points: (n, 3) in the level frame; the view covers them but for a few outliers.
        pixel: size of a photo's pixel on the ground, level units.
    """
    options = options or RenderOptions()
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    low, high = np.percentile(surface_points @ down.T, [options.border_percent, 100 - options.border_percent], axis=0)
    extent = (high - low)[:2]
    pixel = max(pixel, float(extent.max()) / options.max_px)
    shape = (int(np.ceil(extent[1] / pixel)), int(np.ceil(extent[0] / pixel)))
    return View(down, float(low[0]), float(low[1]), pixel, shape)
