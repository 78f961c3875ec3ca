# SPDX-License-Identifier: Apache-2.0
"""Ellipsoids that hold 90 % of the errors of camera positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from skymoor.geo.accuracy import CE90_PER_SIGMA, LE90_PER_SIGMA
from skymoor.results.read import Result
from skymoor.results.tables import CameraRow
from skymoor.types import Array

AXES_90 = 2.5002777108094154
"""Square root of the 90 % quantile of chi squared with three degrees of freedom."""
Kind = Literal["on Earth", "relative to the reference"]
KEYS: dict[Kind, tuple[str, str, str, str]] = {
    "on Earth": ("covariance_m2", "ellipse_90", "ce90", "le90"),
    "relative to the reference": (
        "relative_covariance_m2",
        "relative_ellipse_90",
        "relative_ce90",
        "relative_le90",
    ),
}


@dataclass(frozen=True, eq=False)
class Ellipsoids:
    """Of n cameras, ENU: `positions` (n, 3), `wxyz` (n, 4) of their axes, and `semi_axes` (n, 3) in metres."""

    positions: Array
    wxyz: Array
    semi_axes: Array


def camera_ellipsoids(result: Result, kind: Kind) -> Ellipsoids:
    """Of the cameras whose covariance is known."""
    found = {name: {row["image"]: row for row in one["photos"]} for name, one in result.statistics.items()}
    positions, covariances = [], []
    for row in result.registered_cameras:
        covariance = _covariance(row, found.get(f"{row.set}_{row.component}", {}).get(row.image, {}), kind)
        if covariance is not None and row.up is not None:
            positions.append((row.east, row.north, row.up))
            covariances.append(covariance)
    return ellipsoids(np.array(positions, dtype=np.float64).reshape(-1, 3), np.array(covariances).reshape(-1, 3, 3))


def ellipsoids(positions: Array, covariances: Array) -> Ellipsoids:
    """Of positions (n, 3) in metres with covariances (n, 3, 3) in m^2."""
    variances, axes = np.linalg.eigh(covariances)
    axes = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]  # a rotation, and no mirror
    if not len(axes):
        return Ellipsoids(positions, np.zeros((0, 4)), np.zeros((0, 3)))
    wxyz = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return Ellipsoids(positions, wxyz, AXES_90 * np.sqrt(np.maximum(variances, 0.0)))


def _covariance(row: CameraRow, statistics: Mapping[str, Any], kind: Kind) -> Array | None:
    """(3, 3) m^2; of former versions, from the ellipse and LE90, without what plan and height have in common."""
    whole, plan, circle, height = KEYS[kind]
    if statistics.get(whole) is not None:
        return np.array(statistics[whole], dtype=np.float64)
    ce90, le90 = getattr(row, circle), getattr(row, height)
    if ce90 is None or le90 is None:
        return None
    major, minor, azimuth = statistics.get(plan) or (ce90, ce90, 0.0)
    turn = np.radians(azimuth)
    axes = np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]])  # columns; azimuth is from the north
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = axes @ np.diag(np.square([major, minor]) / CE90_PER_SIGMA**2) @ axes.T
    covariance[2, 2] = (le90 / LE90_PER_SIGMA) ** 2
    return covariance
