# SPDX-License-Identifier: Apache-2.0
"""Geometric consistency of a depth map with those of other photos."""

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

    A depth is confirmed by a map whose depth at the projected point agrees with that of the point. Half of their
    squared difference is the variance of each; the effect of a disparity error of `noise_px` at the angle between the
    rays, which all maps may share, is added.

    Args:
        one, others: depth maps in one frame.
        tolerance_ratio: depths agree within this share of the depth.
        noise_px: standard deviation of a disparity.

    Returns:
        sigma, in the unit of the depth, NaN where no map confirms the depth; and the counts.
    """
    camera, depth = one
    rows, columns = np.nonzero(np.isfinite(depth))
    z = depth[rows, columns].astype(np.float64)
    rays = camera.intrinsics.rays(np.column_stack([columns, rows]) + 0.5)
    points = camera.cam_from_world.inverse().apply(rays * z[:, None])
    count, squares, largest_tangent = np.zeros(len(z)), np.zeros(len(z)), np.zeros(len(z))
    for other in others:
        difference = _difference(points, other)
        agree = np.abs(difference) < tolerance_ratio
        count += agree
        squares += np.where(agree, difference**2, 0.0)
        largest_tangent = np.maximum(largest_tangent, np.where(agree, _tangent(points, camera, other[0]), 0.0))
    sigma, n_views = np.full(depth.shape, np.nan, np.float32), np.zeros(depth.shape, np.uint8)
    known = count > 0
    shared = noise_px / (camera.intrinsics.fx * np.maximum(largest_tangent[known], 1e-6))
    sigma[rows[known], columns[known]] = z[known] * np.hypot(shared, np.sqrt(squares[known] / (2 * count[known])))
    n_views[rows, columns] = count
    return sigma, n_views


def _difference(points: Array, other: Measured) -> Array:
    """Relative difference (n,) of the other map's depth at each point and that of the point, NaN where it has none.

    The nearest pixel is used: interpolation would mix in outliers.
    """
    camera, depth = other
    xyz_cam = camera.cam_from_world.apply(points)
    px = camera.intrinsics.px_from_cam(xyz_cam)
    h, w = depth.shape
    with np.errstate(invalid="ignore"):
        inside = (px > 0).all(axis=1) & (px[:, 0] < w) & (px[:, 1] < h)
    column, row = np.floor(px[inside]).astype(np.intp).T
    ratio = np.full(len(points), np.nan)
    ratio[inside] = depth[row, column] / xyz_cam[inside, 2] - 1
    return ratio


def _tangent(points: Array, camera: Camera, other: Camera) -> Array:
    """Tangent (n,) of the angle between two cameras' rays to points."""
    a, b = points - camera.centre, points - other.centre
    across = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(across / np.maximum(np.einsum("nk,nk->n", a, b), 1e-12))
