# SPDX-License-Identifier: Apache-2.0
"""Registration of a levelled model from 3D matches (paper, section 3.3, compute 3D transforms).

Both frames are level, so two matches give a hypothesis; the consensus is then adjusted with all seven parameters. A
large tilt of the adjusted transform indicates a wrong registration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity, ransac_similarity, refine_similarity, tilt_deg
from skymoor.registration.covariance import matched_covariance
from skymoor.types import Array, Matches3D, Registration

VERTICAL_FLOOR_M, HORIZONTAL_FLOOR_M = 0.1, 0.05


@dataclass(frozen=True)
class RegisterOptions:
    """Estimation and acceptance of a registration.

    Attributes:
        inlier_m: largest residual of an inlier; never below two pixels of the reference.
        correlation_m: matches closer than this are not independent: they count once (see `min_cells`).
        tilt_sigma_deg: uncertainty of the levelling beforehand; a weak observation that stabilises small models.
        min_inliers: fewer are a refusal.
        min_cells: independent cells of `correlation_m` that must hold inliers.
        max_tilt_deg: a registration that tilts the level model by more is a refusal.
        min_score: least match score, beside what decoys say of it; see `decide`.
        min_score_margin: least ratio of the match score to that of a competing hypothesis.
        max_false_alarm: largest probability that a decoy scores and agrees as much.
        max_chance_agreement: the same of the agreement in plan alone.
    """

    inlier_m: float = 1.0
    correlation_m: float = 10.0
    tilt_sigma_deg: float = 3.0
    min_inliers: int = 50
    min_cells: int = 10
    max_tilt_deg: float = 10.0
    min_score: float = 0.0
    min_score_margin: float = 1.3
    max_false_alarm: float = 0.005
    max_chance_agreement: float = 0.05


def register(
    matches: Matches3D,
    reference_pixel_m: float,
    options: RegisterOptions | None = None,
    *,
    rng: np.random.Generator,
    with_covariance: bool = True,
) -> Registration:
    """The similarity that most matches agree on, its covariance and its residuals; not yet accepted or refused.

    `registered` is False only where no transform could be estimated. Matches without a height, as `lift` leaves them
    where the reference has none, are no inliers. The covariance is the slowest part; in a search it can be left out,
    see `with_covariance_of`.
    """
    options = options or RegisterOptions()
    n = len(matches)
    inlier_m = inlier_limit_m(reference_pixel_m, options)
    try:
        known = matches.take(np.flatnonzero(np.isfinite(matches.xyz_enu).all(axis=1)))
        consensus = ransac_similarity(known.xyz_level, known.xyz_enu, inlier_m=inlier_m, rng=rng)
        inliers = consensus.inliers
        source, target = known.xyz_level[inliers], known.xyz_enu[inliers]
        sigma_m = _spread(consensus.transform.apply(source) - target)
        transform, _, _ = refine_similarity(
            source, target, consensus.transform, sigma_m=sigma_m, tilt_sigma_deg=options.tilt_sigma_deg
        )
        plain = Registration(registered=True, reason="", enu_from_level=transform, tilt_deg=tilt_deg(transform))
        found = restated(plain, transform, matches, inlier_m)
        if with_covariance:
            found = with_covariance_of(found, matches, options, rng=rng)
    except (TooFewMatches, DegenerateGeometry) as error:
        return Registration(registered=False, reason=f"no transform: {error}", enu_from_level=None, n_matches=n)
    cells = independent_cells(matches.xyz_enu[found.inliers, :2], options.correlation_m)
    return replace(found, diagnostics={**found.diagnostics, "cells": float(cells)})


def inlier_limit_m(reference_pixel_m: float, options: RegisterOptions) -> float:
    """Largest residual of an inlier: never below two pixels of the reference."""
    return max(options.inlier_m, 2 * reference_pixel_m)


def with_covariance_of(
    found: Registration, matches: Matches3D, options: RegisterOptions, *, rng: np.random.Generator
) -> Registration:
    """The registration with the covariance from its inliers.

    The errors of neighbouring matches are correlated, since their windows overlap; see `matched_covariance`.

    Raises `TooFewMatches` and `DegenerateGeometry` where the inliers do not determine the transform.
    """
    transform = found.enu_from_level
    if transform is None or found.inliers is None or not found.inliers.any():
        raise TooFewMatches("a registration without inliers has no covariance")
    source, target = matches.xyz_level[found.inliers], matches.xyz_enu[found.inliers]
    covariance, centre, correlation_m = matched_covariance(
        source,
        target,
        transform,
        sigma_m=_spread(transform.apply(source) - target),
        tilt_sigma_deg=options.tilt_sigma_deg,
        rng=rng,
    )
    diagnostics = {**found.diagnostics, "errors_reach_m": correlation_m}
    return replace(found, covariance=covariance, centroid_enu=centre, diagnostics=diagnostics)


def restated(found: Registration, enu_from_level: Similarity, matches: Matches3D, inlier_m: float) -> Registration:
    """The registration with another transform, and inliers and residuals of the matches under it."""
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
    """How many cells of `cell_m` hold at least one of the points (n, 3), or of their plan positions (n, 2)."""
    return len(np.unique(np.floor(xyz / cell_m).astype(np.int64), axis=0)) if len(xyz) else 0


def _spread(residuals: Array) -> Array:
    """Robust standard deviation per axis, the same for both horizontal axes."""
    mad = 1.4826 * np.median(np.abs(residuals - np.median(residuals, axis=0)), axis=0)
    horizontal = max(float(np.hypot(mad[0], mad[1]) / np.sqrt(2)), HORIZONTAL_FLOOR_M)
    return np.array([horizontal, horizontal, max(float(mad[2]), VERTICAL_FLOOR_M)])
