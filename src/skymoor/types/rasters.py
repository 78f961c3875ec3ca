# SPDX-License-Identifier: Apache-2.0
"""What has pixels: depth maps, renders, images in plan, warps between them, and the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skymoor.geo import EnuFrame, Grid
from skymoor.types.arrays import Array, Array32, Image, Mask
from skymoor.types.photos import Camera

COARSER = 1.4  # times the orthophoto's pixel, from which on detail is said to be lost


@dataclass(frozen=True, eq=False)
class DepthMap:
    """z-depth of an undistorted pinhole view, NaN where unknown, with its standard deviation, same unit."""

    camera: Camera  # intrinsics without distortion, of the depth map's own size
    depth: Array32
    sigma: Array32
    n_views: NDArray[np.uint8]  # how many stereo partners agree
    rgb: Image

    def points(self, *, max_sigma_ratio: float = 0.02, step: int = 1) -> tuple[Array32, Image]:
        """Points (n, 3) in the camera's world frame, and colours (n, 3), of every `step`-th pixel.

        Pixels count whose depth is more certain than `max_sigma_ratio` of it.
        """
        i = self.camera.intrinsics
        rows, columns = np.arange(step // 2, i.height, step), np.arange(step // 2, i.width, step)
        depth, sigma = self.depth[np.ix_(rows, columns)], self.sigma[np.ix_(rows, columns)]
        with np.errstate(invalid="ignore"):
            row, column = np.nonzero(sigma < max_sigma_ratio * depth)
        rays = i.rays(np.column_stack([columns[column], rows[row]]) + 0.5)
        points = self.camera.cam_from_world.inverse().apply(rays * depth[row, column][:, None])
        return points.astype(np.float32), self.rgb[rows[row], columns[column]]


@dataclass(frozen=True, eq=False)
class View:
    """An orthographic camera: `view_from_level` turns level coordinates to x right, y down, z along the rays.

    Pixel (u, v) is the ray x = x0 + u * pixel, y = y0 + v * pixel of the view frame.
    """

    view_from_level: Array  # (3, 3) rotation
    x0: float
    y0: float
    pixel: float  # size of a pixel in level units
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Render:
    """What a view shows: rgb (h, w, 3), xyz_level (h, w, 3) NaN where nothing is, and confidence in [0, 1]."""

    view: View
    rgb: Image
    xyz: Array32
    confidence: Array32


@dataclass(frozen=True, eq=False)
class Raster:
    """What a dense matcher is given: rgb (h, w, 3), mask of pixels that mean something, and heights where known.

    `height` is in units of a pixel (so that slopes are comparable), NaN where unknown; a matcher may ignore it.
    """

    rgb: Image
    mask: Mask
    height: Array32 | None = None


@dataclass(frozen=True, eq=False)
class Warp:
    """A dense flow both ways. `b_from_a` (ha, wa, 2): the pixel of b for each pixel of a; confidence in [0, 1]."""

    b_from_a: Array32
    confidence_a: Array32
    a_from_b: Array32
    confidence_b: Array32


@dataclass(frozen=True, eq=False)
class Reference:
    """Orthophoto and DSM resampled to one north-up ENU grid.

    `rgb` (h, w, 3) uint8 and `height` (h, w) float32, ENU up in metres, NaN where unknown; `mask` is where the
    orthophoto has data; `covariance` (3, 3) m^2 is the reference's own absolute accuracy, east-north-up. `dsm_pixel_m`
    is infinite where heights come from no raster: all are NaN then, or one constant above the datum. `notes` are
    sentences about how the files were read, one line each.
    """

    frame: EnuFrame
    grid: Grid
    rgb: Image
    mask: Mask
    height: Array32
    covariance: Array
    dsm_pixel_m: float
    crs: str = "EPSG:4326"  # of the orthophoto, for products
    notes: tuple[str, ...] = ()
    finest_m: float = 0.0  # pixel of the orthophoto itself, where the grid is coarser

    @property
    def accuracy_known(self) -> bool:
        """Whether somebody states how accurate it is; if not, `covariance` is NaN."""
        return not np.isnan(self.covariance).any()

    @property
    def detail_lost(self) -> bool:
        """Whether the grid is much coarser than the orthophoto, because of its area."""
        return 0 < self.finest_m < self.grid.pixel_m / COARSER

    def part(self, bounds_m: Sequence[float]) -> Reference:
        """What lies between west, south, east and north in metres, at least a pixel, on whole pixels."""
        (left, bottom), (right, top) = self.grid.px_from_enu(np.reshape(bounds_m, (2, 2)))
        rows, columns = self.grid.shape
        u, v = int(np.clip(left, 0, columns - 1)), int(np.clip(top, 0, rows - 1))
        window = np.s_[v : int(np.clip(np.ceil(bottom), v + 1, rows)), u : int(np.clip(np.ceil(right), u + 1, columns))]
        east, north = self.grid.enu_from_px([float(u), float(v)]).tolist()
        mask = self.mask[window]
        grid = Grid(east, north, self.grid.pixel_m, (mask.shape[0], mask.shape[1]))
        return replace(self, grid=grid, rgb=self.rgb[window], mask=mask, height=self.height[window], notes=())

    @cached_property
    def has_heights(self) -> bool:
        """Whether any height is known."""
        return bool(np.isfinite(self.height).any())

    @property
    def has_relief(self) -> bool:
        """Whether heights come from an elevation model, and not from one number or nothing."""
        return self.has_heights and bool(np.isfinite(self.dsm_pixel_m))
