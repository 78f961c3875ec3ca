# SPDX-License-Identifier: Apache-2.0
"""3D matches to a place on Earth (paper, section 3.3, compute 3D transforms).

Both sides are level, so two matches make a hypothesis; the consensus is then adjusted with all seven parameters, and
how far that tilts the model is a sign of how right it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry.adjust import gauge_centre, point_covariance, refine_similarity, tilt_deg
from skymoor.geometry.ransac import ransac_similarity
from skymoor.geometry.similarity import Similarity
from skymoor.types import Array, Calibration, Camera, Matches3D, Reference, Registration

VERTICAL_FLOOR_M, HORIZONTAL_FLOOR_M = 0.1, 0.05


@dataclass(frozen=True)
class RegisterOptions:
    """Estimation and refusal.

    Attributes:
        inlier_m: largest residual of an inlier; never below two pixels of the reference.
        correlation_m: matches closer than this repeat each other: they count once in the covariance and the refusal.
        tilt_sigma_deg: how well the model is levelled beforehand; a weak observation that holds small models upright.
        min_inliers, min_inlier_ratio: fewer are a refusal (the ratio is the paper's).
        min_cells: independent places that must agree.
        max_tilt_deg: a registration that tilts the level model by more is a refusal.
        min_score, min_score_margin: of the placement search, see `judge`.
    """

    inlier_m: float = 1.0
    correlation_m: float = 10.0
    tilt_sigma_deg: float = 3.0
    min_inliers: int = 50
    min_inlier_ratio: float = 0.2
    min_cells: int = 10
    max_tilt_deg: float = 10.0
    min_score: float = 40.0
    min_score_margin: float = 1.3


def register(
    matches: Matches3D, reference_pixel_m: float, options: RegisterOptions | None = None, *, rng: np.random.Generator
) -> Registration:
    """The similarity that most matches agree on, its covariance and its residuals; not yet judged.

    `registered` is False only where no transform could be estimated.
    """
    options = options or RegisterOptions()
    n = len(matches)
    inlier_m = max(options.inlier_m, 2 * reference_pixel_m)
    try:
        consensus = ransac_similarity(matches.xyz_level, matches.xyz_enu, inlier_m=inlier_m, rng=rng)
        inliers = consensus.inliers
        source, target = matches.xyz_level[inliers], matches.xyz_enu[inliers]
        sigma_m = _spread(consensus.transform.apply(source) - target)
        transform, covariance, weights = refine_similarity(
            source, target, consensus.transform, sigma_m=sigma_m, tilt_sigma_deg=options.tilt_sigma_deg
        )
    except (TooFewMatches, DegenerateGeometry) as error:
        return Registration(registered=False, reason=f"no transform: {error}", enu_from_level=None, n_matches=n)
    plain = Registration(registered=True, reason="", enu_from_level=transform, tilt_deg=tilt_deg(transform))
    found = restated(plain, transform, matches, inlier_m)
    cells = independent_cells(matches.xyz_enu[found.inliers, :2], options.correlation_m)
    # Windows of neighbouring matches overlap: five thousand matches are not five thousand measurements.
    repeats = max(1.0, len(source) / max(1, cells))
    return replace(
        found,
        covariance=covariance * repeats,
        centroid_enu=gauge_centre(transform, source, weights),
        diagnostics={"cells": float(cells)},
    )


def restated(found: Registration, enu_from_level: Similarity, matches: Matches3D, inlier_m: float) -> Registration:
    """The registration with a transform from elsewhere, and with what the matches say of that one."""
    residuals = enu_from_level.apply(matches.xyz_level) - matches.xyz_enu
    inliers = np.linalg.norm(residuals, axis=1) <= inlier_m
    near = residuals[inliers]
    return replace(
        found,
        enu_from_level=enu_from_level,
        n_matches=len(matches),
        n_inliers=len(near),
        rmse_m=float(np.sqrt((near**2).sum(axis=1).mean())) if len(near) else float("nan"),
        inliers=inliers,
        residuals_m=residuals,
    )


def independent_cells(xyz: Array, cell_m: float) -> int:
    """How many cells of `cell_m` hold at least one of the points (n, 3), or of their places in plan (n, 2)."""
    return len(np.unique(np.floor(xyz / cell_m).astype(np.int64), axis=0)) if len(xyz) else 0


def camera_covariances(
    registration: Registration, cameras_enu: list[Camera], reference: Reference, calibration: Calibration | None
) -> Array:
    """Predicted covariances (n, 3, 3) of camera positions in ENU, m^2: reference, registration and focal length.

    A focal length that is wrong by one percent puts every camera one percent of its height too high.
    """
    if registration.covariance is None or registration.centroid_enu is None:
        raise TooFewMatches("an unregistered model has no accuracy")
    centres = np.array([camera.centre for camera in cameras_enu])
    covariances = reference.covariance + point_covariance(registration.covariance, registration.centroid_enu, centres)
    if calibration is not None:
        above = centres[:, 2] - registration.centroid_enu[2]
        covariances[:, 2, 2] += (calibration.focal_sigma * above) ** 2
    return np.asarray(covariances)


def _spread(residuals: Array) -> Array:
    """Robust standard deviation per axis, the horizontal ones alike."""
    mad = 1.4826 * np.median(np.abs(residuals - np.median(residuals, axis=0)), axis=0)
    horizontal = max(float(np.hypot(mad[0], mad[1]) / np.sqrt(2)), HORIZONTAL_FLOOR_M)
    return np.array([horizontal, horizontal, max(float(mad[2]), VERTICAL_FLOOR_M)])
