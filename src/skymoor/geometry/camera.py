# SPDX-License-Identifier: Apache-2.0
"""The frame camera: focal lengths, principal point and Brown's distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import DegenerateGeometry

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Intrinsics:
    """A frame camera with Brown's distortion (k1, k2, p1, p2), as COLMAP's OPENCV model.

    `width`, `height`, focal lengths and principal point are in pixels; the centre of the first pixel is at
    (0.5, 0.5), as in COLMAP. OpenCV puts it at (0, 0): `matrix_cv` is the matrix for its functions.
    Raises `DegenerateGeometry` for an empty image, a focal length that is not positive, or values not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if len(values) != 8:
            raise ValueError("distortion is (k1, k2, p1, p2)")
        if not np.isfinite(values).all() or self.fx <= 0 or self.fy <= 0 or self.width < 1 or self.height < 1:
            raise DegenerateGeometry(f"a camera needs a size, positive focal lengths and finite values: {self}")

    def matrix(self) -> Array:
        """Pixels from unit-z rays (3, 3), first pixel centre at (0.5, 0.5)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def matrix_cv(self) -> Array:
        """The same (3, 3) for OpenCV, first pixel centre at (0, 0)."""
        return np.array([[self.fx, 0.0, self.cx - 0.5], [0.0, self.fy, self.cy - 0.5], [0.0, 0.0, 1.0]])

    @cached_property
    def max_radius(self) -> float:
        """Undistorted radius (unit-z plane) up to which the radial distortion grows; infinite if it always does.

        Beyond it the polynomial is not invertible and would project far points into the image.
        """
        k1, k2 = self.distortion[:2]
        # d/dr of r + k1 r^3 + k2 r^5, as a polynomial of r^2.
        roots = np.roots([5.0 * k2, 3.0 * k1, 1.0])
        turning_points = roots[(np.abs(roots.imag) < 1e-12 * np.abs(roots)) & (roots.real > 0)].real
        return float(np.sqrt(turning_points.min())) if turning_points.size else float("inf")

    def px_from_cam(self, points: ArrayLike) -> Array:
        """Project points (n, 3) of the camera frame (x right, y down, z forward) to pixels (n, 2).

        Gives NaN behind the camera and beyond `max_radius`, where the model is not valid; the image border is not
        tested.
        """
        xyz_cam = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        z = np.where(xyz_cam[:, 2] > 0, xyz_cam[:, 2], np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            xy = xyz_cam[:, :2] / z[:, None]
            r2 = np.sum(xy**2, axis=1)
            xy = np.where((r2 < self.max_radius**2)[:, None], xy, np.nan)
            if any(self.distortion):
                xy = self._distort(xy, r2)
        return xy * [self.fx, self.fy] + [self.cx, self.cy]

    def rays(self, px: ArrayLike) -> Array:
        """Directions (n, 3) with z = 1 in the camera frame through the pixels (n, 2)."""
        uv = np.asarray(px, dtype=np.float64).reshape(-1, 2)
        xy = (uv - [self.cx, self.cy]) / [self.fx, self.fy]
        if any(self.distortion) and len(uv):
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
            start = cv2.undistortPoints(
                xy[:, None, :], np.eye(3), np.array(self.distortion), R=np.eye(3), P=np.eye(3), criteria=criteria
            )
            xy = self._newton(np.asarray(start, dtype=np.float64).reshape(-1, 2), xy)
        return np.column_stack([xy, np.ones(len(uv))])

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same camera for the image resampled to another size."""
        across, down = width / self.width, height / self.height
        return replace(
            self,
            width=int(width),
            height=int(height),
            fx=self.fx * across,
            fy=self.fy * down,
            cx=self.cx * across,
            cy=self.cy * down,
        )

    def undistorted(self) -> Intrinsics:
        """The camera with the same size, focal lengths and principal point, and no distortion."""
        return replace(self, distortion=(0.0, 0.0, 0.0, 0.0))

    def _distort(self, xy: Array, r2: Array) -> Array:
        k1, k2, p1, p2 = self.distortion
        x, y = xy[:, 0], xy[:, 1]
        radial = 1.0 + r2 * (k1 + r2 * k2)
        dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.column_stack([x * radial + dx, y * radial + dy])

    def _newton(self, xy: Array, distorted: Array) -> Array:
        """Newton steps: OpenCV's fixed-point iteration converges slowly under strong distortion."""
        k1, k2, p1, p2 = self.distortion
        for _ in range(5):
            x, y = xy[:, 0], xy[:, 1]
            r2 = x * x + y * y
            radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * k2 * r2)
            a = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            b = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            d = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            gap = distorted - self._distort(xy, r2)
            det = a * d - b * b
            # Near the turning point of the polynomial a Newton step would change branches: keep OpenCV's solution.
            safe = det > 1e-3
            det = np.where(safe, det, 1.0)
            step = np.column_stack([d * gap[:, 0] - b * gap[:, 1], a * gap[:, 1] - b * gap[:, 0]]) / det[:, None]
            xy = np.where(safe[:, None], xy + step, xy)
        return xy
