# SPDX-License-Identifier: Apache-2.0
"""Registration of a levelled model on the map, with heights apart (paper, section 3.3, and beyond it).

Position, azimuth and scale come from what agrees in plan. Tilt and height come from the elevation model as far as its
heights can be believed, and from the levelling otherwise: an elevation model of another unit, datum, date or resolution
makes heights less certain, and neither moves nor refuses a place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity, tilt_deg
from skymoor.registration.covariance import plan_covariance
from skymoor.registration.heights import HeightFit
from skymoor.registration.plan import PlanFit
from skymoor.types import Array, HeightVerdict, Matches3D, Registration

FINE_M = 6.0
"""Resolution up to which the jackknife's figures of offset and slope are believed. Coarser elevation models err over
distances that a site does not show: their errors count as if they were one."""
HIDDEN_M = 5.0
"""Uncertainty of the mean height of what stereo does not measure: water, or crowns of ten metres."""
LEVER = 0.3  # standard deviation of positions, as a share of the model's extent: of a uniform distribution


@dataclass(frozen=True, eq=False)
class _Vertical:
    """Slope (2,) of the model's correction and offset at `centre` (3,), with their covariance (3, 3)."""

    slope: Array
    offset_m: float
    covariance: Array
    centre: Array


def flat_transform(fit: PlanFit) -> Similarity:
    """Target from source of a similarity in plan, with neither tilt nor offset in height."""
    turn = Rotation.from_euler("z", fit.azimuth_rad).as_matrix()
    return Similarity(fit.scale, turn, np.array([fit.shift.real, fit.shift.imag, 0.0]))


def place_on_map(
    matches: Matches3D,
    plan: PlanFit,
    heights: HeightFit | None,
    verdict: HeightVerdict,
    above_ground_m: Array,
    *,
    tilt_sigma_deg: float,
    rng: np.random.Generator,
) -> Registration:
    """The registration with its covariance, its residuals and the verdict on heights; not yet accepted or refused.

    Args:
        matches: heights of the reference may be NaN.
        plan: the similarity in plan of the untilted model.
        heights: of the model under `flat_transform(plan)` against the reference's; None where there are none.
        verdict: on them.
        above_ground_m: (n,) of the model's points.
        tilt_sigma_deg: uncertainty of the levelling.
        rng: draws the matches that are used for the covariance.

    Raises `TooFewMatches` where the matches do not determine the transform.
    """
    flat = flat_transform(plan)
    points = flat.apply(matches.xyz_level)
    extent_m = float(np.ptp(points[plan.inliers, :2], axis=0).min())
    vertical = _vertical(heights, verdict, points[plan.inliers].mean(axis=0), extent_m, np.radians(tilt_sigma_deg))
    tilted = _tilted(flat, vertical)
    fit = plan.refitted(tilted.apply(matches.xyz_level)[:, :2], matches.xyz_enu[:, :2], above_ground_m)
    transform = flat_transform(fit) @ tilted
    model = transform.apply(matches.xyz_level)
    centre = np.average(model, axis=0, weights=fit.weights)
    raised = np.nan_to_num(above_ground_m) if fit.lean else None
    in_plan, correlation_m = plan_covariance(model[:, :2] - centre[:2], fit.residuals, fit.weights, raised, rng=rng)
    residuals = np.column_stack([fit.residuals, model[:, 2] - matches.xyz_enu[:, 2]])
    near = fit.residuals[fit.inliers]
    return Registration(
        registered=True,
        reason="",
        enu_from_level=transform,
        n_matches=len(matches),
        n_inliers=int(fit.inliers.sum()),
        tilt_deg=tilt_deg(transform),
        rmse_m=float(np.sqrt((near**2).sum(axis=1).mean())),
        covariance=_joined(in_plan, vertical, centre),
        centroid_enu=centre,
        inliers=fit.inliers,
        residuals_m=residuals,
        diagnostics={"errors_reach_m": correlation_m},
        heights=verdict,
        lean=(fit.lean.real, fit.lean.imag) if fit.lean else None,
    )


def _vertical(
    heights: HeightFit | None, verdict: HeightVerdict, middle: Array, extent_m: float, tilt_sigma: float
) -> _Vertical:
    """Slope and offset from the levelling and the reference, weighted by their covariances."""
    prior = np.eye(2) / tilt_sigma**2
    if heights is None:
        return _Vertical(np.zeros(2), 0.0, np.diag([tilt_sigma**2, tilt_sigma**2, 0.0]), middle)
    covariance = heights.covariance[:3, :3].copy()
    fine = np.isfinite(heights.resolution_m) and heights.resolution_m <= FINE_M
    if verdict.status != "CONFIRMED" or not fine:
        lever = max(LEVER * extent_m, 1.0)
        whole = heights.spread_m**2 + (HIDDEN_M * heights.hidden_share) ** 2
        covariance += np.diag([heights.spread_m**2 / lever**2] * 2 + [whole])
    believed = np.isfinite(covariance).all() and verdict.status != "NOT_CONFIRMED"
    if not believed or heights.reference_relief_m == 0:
        tilt = np.diag([tilt_sigma**2, tilt_sigma**2, covariance[2, 2]])
        return _Vertical(np.zeros(2), heights.offset_m, tilt, heights.centre)
    information = np.linalg.inv(covariance[:2, :2])
    slope_covariance = np.linalg.inv(prior + information)
    joint = np.block([[slope_covariance, np.zeros((2, 1))], [np.zeros((1, 2)), covariance[2:, 2:]]])
    return _Vertical(slope_covariance @ information @ heights.slope, heights.offset_m, joint, heights.centre)


def _tilted(flat: Similarity, vertical: _Vertical) -> Similarity:
    """Turned about the vertical correction's centre, and raised there."""
    east, north = vertical.slope
    turn = Rotation.from_rotvec([north, -east, 0.0]).as_matrix()
    centre = vertical.centre
    return Similarity(1.0, turn, centre + [0.0, 0.0, vertical.offset_m] - turn @ centre) @ flat


def _joined(in_plan: Array, vertical: _Vertical, centre: Array) -> Array:
    """Covariance (7, 7) of log scale, rotation vector and translation at `centre`, see `refine_similarity`."""
    east, north = centre[:2] - vertical.centre[:2]
    # Up at the centre of the plan, from slope and offset at the centre of heights.
    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [east, north, 1.0]])
    slopes_up = shift @ vertical.covariance @ shift.T
    # A rotation w raises (x, y) by w_x y - w_y x: w_x is the slope north, w_y minus the slope east.
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    covariance = np.zeros((7, 7))
    plan, up = [0, 3, 4, 5], [1, 2, 6]
    covariance[np.ix_(plan, plan)] = in_plan
    covariance[np.ix_(up, up)] = turn @ slopes_up @ turn.T
    return covariance
