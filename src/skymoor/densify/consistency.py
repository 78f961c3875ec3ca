# SPDX-License-Identifier: Apache-2.0
"""Which depths of a photo the depth maps of others confirm, and how well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Array32, Camera

Measured = tuple[Camera, Array32]
"""A camera without distortion and its z-depth (h, w), NaN where unknown."""


def confirmed(
    one: Measured, others: Sequence[Measured], *, tolerance_ratio: float, noise_px: float
) -> tuple[Array32, NDArray[np.uint8]]:
    """The standard deviation (h, w) of a map's depths, and how many other maps confirm each (h, w).

    A depth is confirmed by a map that has about the depth there that the point ought to have. What the two differ by
    they have each half of, in the variance; to that comes what a disparity wrong by `noise_px` does at the angle
    between the rays, which all maps may share.

    Args:
        one, others: measured in one frame.
        tolerance_ratio: depths agree within this share of the depth.
        noise_px: standard deviation of a disparity.

    Returns:
        sigma, NaN where nothing confirms the depth, in the unit of the depth; and the counts.
    """
    camera, depth = one
    rows, columns = np.nonzero(np.isfinite(depth))
    z = depth[rows, columns].astype(np.float64)
    rays = camera.intrinsics.rays(np.column_stack([columns, rows]) + 0.5)
    points = camera.cam_from_world.inverse().apply(rays * z[:, None])
    count, squares, sharpest = np.zeros(len(z)), np.zeros(len(z)), np.zeros(len(z))
    for other in others:
        differs = _difference(points, other)
        agrees = np.abs(differs) < tolerance_ratio
        count += agrees
        squares += np.where(agrees, differs**2, 0.0)
        sharpest = np.maximum(sharpest, np.where(agrees, _tangent(points, camera, other[0]), 0.0))
    sigma, n_views = np.full(depth.shape, np.nan, np.float32), np.zeros(depth.shape, np.uint8)
    some = count > 0
    shared = noise_px / (camera.intrinsics.fx * np.maximum(sharpest[some], 1e-6))
    sigma[rows[some], columns[some]] = z[some] * np.hypot(shared, np.sqrt(squares[some] / (2 * count[some])))
    n_views[rows, columns] = count
    return sigma, n_views


def _difference(points: Array, other: Measured) -> Array:
    """By which share (n,) the other map's depth at each point is off the point's own, NaN where it has none.

    The pixel counts that the point falls into: between pixels, a mean would be spoiled by any one that is wrong.
    """
    camera, depth = other
    seen_from = camera.cam_from_world.apply(points)
    px = camera.intrinsics.px_from_cam(seen_from)
    h, w = depth.shape
    with np.errstate(invalid="ignore"):
        inside = (px > 0).all(axis=1) & (px[:, 0] < w) & (px[:, 1] < h)
    column, row = np.floor(px[inside]).astype(np.intp).T
    share = np.full(len(points), np.nan)
    share[inside] = depth[row, column] / seen_from[inside, 2] - 1
    return share


def _tangent(points: Array, camera: Camera, other: Camera) -> Array:
    """Of the angle (n,) between two cameras' rays to points."""
    a, b = points - camera.centre, points - other.centre
    across = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(across / np.maximum(np.einsum("nk,nk->n", a, b), 1e-12))
