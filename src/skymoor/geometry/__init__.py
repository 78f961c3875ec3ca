# SPDX-License-Identifier: Apache-2.0
"""Geometry in float64, independent of images and maps."""

from skymoor.geometry.adjust import (
    gauge_centre,
    moved_similarity,
    point_covariance,
    refine_similarity,
    similarity_jacobian,
    tilt_deg,
)
from skymoor.geometry.camera import Intrinsics
from skymoor.geometry.plane import Plane, fit_plane_ransac
from skymoor.geometry.ransac import RansacResult, ransac_similarity
from skymoor.geometry.similarity import Similarity, umeyama, umeyama_level

__all__ = [
    "Intrinsics",
    "Plane",
    "RansacResult",
    "Similarity",
    "fit_plane_ransac",
    "gauge_centre",
    "moved_similarity",
    "point_covariance",
    "ransac_similarity",
    "refine_similarity",
    "similarity_jacobian",
    "tilt_deg",
    "umeyama",
    "umeyama_level",
]
