# SPDX-License-Identifier: Apache-2.0
"""North-up raster grids in the local frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Square pixels in ENU metres, rows going south.

    (`east0`, `north0`) is the outer corner of the top-left pixel, which has pixel coordinates (0, 0); that pixel's
    centre is (0.5, 0.5). `shape` is (rows, columns).
    """

    east0: float
    north0: float
    pixel_m: float
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if not np.isfinite([self.east0, self.north0, self.pixel_m]).all() or self.pixel_m <= 0 or min(self.shape) < 1:
            raise ValueError(f"not a grid (finite origin, positive pixel and shape are required): {self}")

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north edges in metres."""
        rows, columns = self.shape
        east1, south = self.east0 + columns * self.pixel_m, self.north0 - rows * self.pixel_m
        return self.east0, south, east1, self.north0

    def px_from_enu(self, xy: ArrayLike) -> Array:
        """Pixel coordinates (n, 2), u to the east and v to the south, of plan positions (n, 2) in metres."""
        plan = np.asarray(xy, dtype=np.float64)
        return np.stack([plan[..., 0] - self.east0, self.north0 - plan[..., 1]], axis=-1) / self.pixel_m

    def enu_from_px(self, px: ArrayLike) -> Array:
        """Plan positions (n, 2) in metres of pixel coordinates (n, 2)."""
        uv = np.asarray(px, dtype=np.float64)
        return np.stack([self.east0 + uv[..., 0] * self.pixel_m, self.north0 - uv[..., 1] * self.pixel_m], axis=-1)

    def centres(self) -> Array:
        """Plan positions (rows, columns, 2) of the pixel centres in metres."""
        rows, columns = self.shape
        u, v = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        return self.enu_from_px(np.stack([u, v], axis=-1))


def sample(raster: NDArray[np.floating], px: ArrayLike) -> Array:
    """Bilinear values (n,) of a raster (h, w) at pixel coordinates (n, 2), first pixel centre at (0.5, 0.5).

    A value is NaN when any of the four neighbours that carries weight is NaN or outside the raster: heights are
    never interpolated with unknown ones.
    """
    rows, columns = raster.shape
    uv = np.asarray(px, dtype=np.float64).reshape(-1, 2) - 0.5
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] <= columns - 1) & (uv[:, 1] <= rows - 1)
    uv = np.where(inside[:, None], uv, 0.0)
    left, top = np.floor(uv).astype(np.intp).T
    du, dv = uv[:, 0] - left, uv[:, 1] - top
    value = np.zeros(len(uv))
    for row, down in ((top, 1.0 - dv), (top + 1, dv)):
        for column, across in ((left, 1.0 - du), (left + 1, du)):
            weight = down * across
            neighbour = raster[np.minimum(row, rows - 1), np.minimum(column, columns - 1)].astype(np.float64)
            # A neighbour without weight may be NaN, and 0 * NaN is NaN.
            value += np.where(weight > 0, weight * neighbour, 0.0)
    return np.where(inside, value, np.nan)
