# SPDX-License-Identifier: Apache-2.0
"""2D matches to 3D matches (paper, section 3.3, lifting 2D matches to 3D points)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.geo import sample
from skymoor.types import Array, Array32, Matches2D, Matches3D, Reference, Render


@dataclass(frozen=True)
class LiftOptions:
    """Which pixels are lifted to 3D points.

    Attributes:
        min_confidence: of the render.
        max_step_slope: a height step within a pixel's neighbourhood steeper than this is an edge, where half a pixel of
            match error becomes metres of height.
        edge_m: width of the neighbourhood, metres on the ground.
    """

    min_confidence: float = 0.3
    max_step_slope: float = 1.0
    edge_m: float = 1.5


def lift(
    matches: Matches2D,
    render: Render,
    reference: Reference,
    metres_per_level: float,
    options: LiftOptions | None = None,
) -> Matches3D:
    """Points of both sides for matches from the render (a) to the reference (b).

    Matches are dropped where the render has no height or is not confident, near its height steps, and outside of the
    reference. The reference's height is NaN where it has none, and near its height steps: a match is good in plan
    without it. `metres_per_level` is the approximate scale of the model; it converts `edge_m` to level units.
    """
    options = options or LiftOptions()
    xyz_level = np.column_stack([sample(render.xyz[..., axis], matches.px_a) for axis in range(3)])
    east_north = reference.grid.enu_from_px(matches.px_b)
    up = sample(reference.height, matches.px_b)
    edge_level = options.edge_m / metres_per_level
    rows, columns = reference.grid.shape
    good = np.isfinite(xyz_level).all(axis=1)
    good &= ((matches.px_b >= 0) & (matches.px_b <= [columns, rows])).all(axis=1)
    good &= sample(render.confidence, matches.px_a) >= options.min_confidence
    step_a = height_step(render.xyz[..., 2], edge_level / render.view.pixel)
    step_b = height_step(reference.height, options.edge_m / reference.grid.pixel_m)
    good &= _at(step_a, matches.px_a) <= options.max_step_slope * edge_level
    up[_at(step_b, matches.px_b) > options.max_step_slope * options.edge_m] = np.nan
    xyz_enu = np.column_stack([east_north, up])
    return Matches3D(xyz_level[good], xyz_enu[good], matches.take(good))


def height_step(height: Array32, width_px: float) -> Array32:
    """Difference of the highest and the lowest height within a square of `width_px`; inf where it has none."""
    width = 2 * max(1, round(width_px / 2)) + 1
    kernel = np.ones((width, width), np.uint8)
    known = np.isfinite(height)
    unknown = np.float32(1e9)  # beyond any height, and far from where a difference overflows
    high = cv2.dilate(np.where(known, height, -unknown).astype(np.float32), kernel, borderValue=-float(unknown))
    low = cv2.erode(np.where(known, height, unknown).astype(np.float32), kernel, borderValue=float(unknown))
    return np.where(high >= low, high - low, np.inf).astype(np.float32)


def _at(raster: Array32, px: Array) -> Array32:
    """Values of the pixels that hold positions (n, 2), inf outside."""
    u, v = np.floor(px).astype(int).T
    h, w = raster.shape
    inside = (u >= 0) & (v >= 0) & (u < w) & (v < h)
    return np.where(inside, raster[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)], np.inf).astype(np.float32)
