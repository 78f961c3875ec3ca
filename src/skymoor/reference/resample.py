# SPDX-License-Identifier: Apache-2.0
"""Mapping of the pixels of a grid to those of a raster in another CRS, tile by tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from skymoor.geo import EnuFrame, Grid
from skymoor.reference.raster import MapRaster, window_around

Array = NDArray[np.float64]

# Between nodes this far apart, map projections, the geoid and the curvature of the Earth are linear to well below a
# millimetre.
LATTICE_PX = 16
LATTICE_M = 80.0
# Samples along the side of a pixel; the mean over more does not improve.
SAMPLES = 32


@dataclass(frozen=True, eq=False)
class Lattice:
    """Sparse nodes over a tile of the grid, and the linear interpolation from them to its pixel centres."""

    lla: Array  # (m * n, 3), of the nodes at up = 0
    nodes: tuple[Array, Array]  # node rows and columns in pixels
    centres: tuple[Array, Array]  # pixel centres in pixels

    @classmethod
    def of(cls, grid: Grid, rows: slice, columns: slice, frame: EnuFrame) -> Lattice:
        centres = tuple(np.arange(side.start, side.stop) + 0.5 for side in (rows, columns))
        spacing = int(np.clip(LATTICE_M / grid.pixel_m, 1, LATTICE_PX))
        nodes = tuple(np.linspace(c[0], c[-1], 2 + len(c) // spacing) for c in centres)
        v, u = np.meshgrid(*nodes, indexing="ij")
        plan = grid.enu_from_px(np.column_stack([u.ravel(), v.ravel()]))
        lla = frame.lla_from_enu(np.column_stack([plan, np.zeros(len(plan))]))
        return cls(lla, (nodes[0], nodes[1]), (centres[0], centres[1]))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the tile."""
        return len(self.centres[0]), len(self.centres[1])

    def spread(self, values: Array) -> Array:
        """Values (rows, columns) at the pixel centres of values (m * n,) at the nodes."""
        table = values.reshape(len(self.nodes[0]), len(self.nodes[1]))
        for axis in (0, 1):
            nodes, centres = self.nodes[axis], self.centres[axis]
            position = (centres - nodes[0]) / max(nodes[1] - nodes[0], 1e-9)
            low = np.minimum(position.astype(np.intp), len(nodes) - 2)
            share = np.expand_dims(position - low, 1 - axis)
            table = np.take(table, low, axis) * (1.0 - share) + np.take(table, low + 1, axis) * share
        return table

    def px(self, raster: MapRaster) -> tuple[Array, Array]:
        """Pixel coordinates u and v, each (rows, columns), in a raster."""
        px = raster.px_from_lonlat(self.lla[:, [1, 0]])
        return self.spread(px[:, 0]), self.spread(px[:, 1])


@dataclass(frozen=True, eq=False)
class Cut:
    """The part of a raster under a tile of the grid: every `thin`-th row and column of `window` is read.

    The samples are averaged over blocks of `step` before resampling.
    """

    window: Window
    thin: tuple[int, int]  # rows, columns
    step: tuple[int, int]
    u: Array  # columns and rows in averaged blocks, one per pixel of the tile
    v: Array

    @classmethod
    def of(cls, raster: MapRaster, lattice: Lattice) -> Cut | None:
        """The cut for a tile; None where the raster does not cover it."""
        u, v = lattice.px(raster)
        rates = _rate(v), _rate(u)
        thin = tuple(max(1, rate // SAMPLES) for rate in rates)
        step = tuple(rate // every for rate, every in zip(rates, thin, strict=True))
        rows, columns = (count * every for count, every in zip(step, thin, strict=True))
        window = window_around(np.column_stack([u.ravel(), v.ravel()]), raster.shape, (rows, columns))
        if window is None:
            return None
        # Whole samples only: GDAL would stretch an incomplete one at the border.
        height, width = (
            int(side) // every * every for side, every in zip((window.height, window.width), thin, strict=True)
        )
        whole = Window(window.col_off, window.row_off, width, height)
        return cls(
            whole, (thin[0], thin[1]), (step[0], step[1]), (u - window.col_off) / columns, (v - window.row_off) / rows
        )


def _rate(source_px: Array) -> int:
    """Whole source pixels per grid pixel, from the source column (or row) of each pixel of a tile, at least 1."""
    rows, columns = source_px.shape
    across = np.ptp(source_px[rows // 2]) / max(columns - 1, 1)
    down = np.ptp(source_px[:, columns // 2]) / max(rows - 1, 1)
    rate = float(np.hypot(across, down))
    return max(1, round(rate)) if np.isfinite(rate) else 1
