# SPDX-License-Identifier: Apache-2.0
"""The accuracy table: absolute, relative, similarity-fitted and Mahalanobis errors of every component.

The measures are those of Bredvik, Richardson and Crispell (2025), section on results: absolute error is the distance
of a camera to its true position, relative error the same after the component's mean error vector is removed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import DegenerateGeometry, InputError, TooFewMatches
from skymoor.geo import EnuFrame, mahalanobis
from skymoor.geometry import umeyama

Array = NDArray[np.float64]

NAMED_IN_MESSAGE = 3


@dataclass(frozen=True)
class Estimate:
    """One line of cameras.csv: WGS 84 degrees and ellipsoidal metres, all None where the camera is not registered.

    The height alone is None where the heights are not confirmed.

    `component` is None for an image that is in no reconstruction; `ce90`, `le90` are the predicted accuracy in metres,
    `relative_ce90`, `relative_le90` the same without the error of the reference.
    """

    image: str
    set: str
    component: int | None
    registered: bool
    lat: float | None = None
    lon: float | None = None
    height: float | None = None
    ce90: float | None = None
    le90: float | None = None
    relative_ce90: float | None = None
    relative_le90: float | None = None
    heights: str | None = None


@dataclass(frozen=True)
class Truth:
    """One line of truth.csv: WGS 84 degrees and ellipsoidal metres."""

    image: str
    lat: float
    lon: float
    height: float


@dataclass(frozen=True)
class EvaluationRow:
    """One component against the truth. Metres, except the two Mahalanobis distances and the two shares of cameras.

    The error is split: the bias is the mean error vector, which includes the reference's own error; the relative error
    is what remains without it; the part of that which no similarity removes is the reconstruction's. The shares are of
    the cameras whose horizontal error is within their predicted CE90, and whose vertical error is within their LE90.
    (They share the reference's error: of one component, most are within or most are not.)

    Every measure is None where the component is not registered, the two Mahalanobis distances where the accuracy of the
    reference is unknown, and those that need heights where its heights are not
    confirmed; `rmse_procrustes_m` also where fewer than three cameras
    or collinear ones do not determine the fit. `n_truth` counts the component's cameras that are in the truth. The
    measures are of the registered ones among them; `n_without_truth` counts the registered ones that are not.
    """

    set: str
    component: int
    status: str
    n_cameras: int
    n_truth: int
    mean_absolute_m: float | None = None
    median_absolute_m: float | None = None
    mean_horizontal_m: float | None = None
    mean_vertical_m: float | None = None
    mean_relative_m: float | None = None
    median_relative_m: float | None = None
    rmse_procrustes_m: float | None = None
    mahalanobis_of_mean: float | None = None
    mean_mahalanobis: float | None = None
    standoff_m: float | None = None
    predicted_ce90_m: float | None = None
    predicted_le90_m: float | None = None
    bias_east_m: float | None = None
    bias_north_m: float | None = None
    bias_up_m: float | None = None
    predicted_relative_ce90_m: float | None = None
    predicted_relative_le90_m: float | None = None
    share_within_ce90: float | None = None
    share_within_le90: float | None = None
    n_without_truth: int = 0


def evaluate(
    estimates: Sequence[Estimate],
    truths: Sequence[Truth],
    frame: EnuFrame,
    covariance: Array,
    scene_centres: Mapping[tuple[str, int], Array],
) -> list[EvaluationRow]:
    """One row for each set and component, in the order of their first camera.

    `covariance` (3, 3) m^2, east-north-up of `frame`, normalises the Mahalanobis distances: the reference's, or the
    predicted one. `scene_centres` gives, by (set, component), the point (3,) ENU that the standoff is measured to; a
    component without one has no standoff. Images without a component are left out.

    Raises `InputError` when an image is listed twice, or the truth has none of the registered cameras.
    """
    _require_unique([truth.image for truth in truths], "the truth")
    _require_unique([estimate.image for estimate in estimates], "the cameras")
    lla = np.array([(truth.lat, truth.lon, truth.height) for truth in truths]).reshape(-1, 3)
    enu = frame.enu_from_lla(lla[:, 0], lla[:, 1], lla[:, 2]) if truths else np.zeros((0, 3))
    truth_enu = {truth.image: position for truth, position in zip(truths, enu, strict=True)}
    _require_common(estimates, truth_enu)
    groups: dict[tuple[str, int], list[Estimate]] = {}
    for estimate in estimates:
        if estimate.component is not None:
            groups.setdefault((estimate.set, estimate.component), []).append(estimate)
    return [_row(name, group, truth_enu, frame, covariance, scene_centres.get(name)) for name, group in groups.items()]


def _row(
    name: tuple[str, int],
    group: Sequence[Estimate],
    truth_enu: Mapping[str, Array],
    frame: EnuFrame,
    covariance: Array,
    scene_centre: Array | None,
) -> EvaluationRow:
    # A camera that contradicts its component has no position; the others have.
    registered = [estimate for estimate in group if estimate.registered]
    n_truth = sum(estimate.image in truth_enu for estimate in group)
    if not registered:
        return EvaluationRow(*name, "NOT_REGISTERED", len(group), n_truth)
    n_cameras, group = len(registered), [one for one in registered if one.image in truth_enu]
    without = n_cameras - len(group)
    if not group:
        return EvaluationRow(*name, "REGISTERED", n_cameras, n_truth, n_without_truth=without)
    truth = np.array([truth_enu[estimate.image] for estimate in group])
    positions = _positions(group, truth, frame)
    errors = positions - truth
    horizontal, vertical = np.linalg.norm(errors[:, :2], axis=1), np.abs(errors[:, 2])
    bias = errors.mean(axis=0)
    if any(estimate.height is None for estimate in group):
        row = _in_plan(name, group, n_truth, horizontal, bias)
        return replace(row, n_cameras=n_cameras, n_without_truth=without)
    absolute, relative = np.linalg.norm(errors, axis=1), np.linalg.norm(errors - bias, axis=1)
    return EvaluationRow(
        *name,
        "REGISTERED",
        n_cameras,
        n_truth,
        n_without_truth=without,
        mean_absolute_m=float(absolute.mean()),
        median_absolute_m=float(np.median(absolute)),
        mean_horizontal_m=float(horizontal.mean()),
        mean_vertical_m=float(vertical.mean()),
        mean_relative_m=float(relative.mean()),
        median_relative_m=float(np.median(relative)),
        rmse_procrustes_m=_rmse_procrustes(positions, truth),
        mahalanobis_of_mean=_known(mahalanobis(bias[None], covariance)[0]),
        mean_mahalanobis=_known(mahalanobis(errors, covariance).mean()),
        standoff_m=None if scene_centre is None else float(np.linalg.norm(positions - scene_centre, axis=1).mean()),
        predicted_ce90_m=_mean([estimate.ce90 for estimate in group]),
        predicted_le90_m=_mean([estimate.le90 for estimate in group]),
        bias_east_m=float(bias[0]),
        bias_north_m=float(bias[1]),
        bias_up_m=float(bias[2]),
        predicted_relative_ce90_m=_mean([estimate.relative_ce90 for estimate in group]),
        predicted_relative_le90_m=_mean([estimate.relative_le90 for estimate in group]),
        share_within_ce90=_share_within(horizontal, [estimate.ce90 for estimate in group]),
        share_within_le90=_share_within(vertical, [estimate.le90 for estimate in group]),
    )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _in_plan(
    name: tuple[str, int], group: Sequence[Estimate], n_truth: int, horizontal: Array, bias: Array
) -> EvaluationRow:
    """The measures that need no heights."""
    return EvaluationRow(
        *name,
        "REGISTERED",
        len(group),
        n_truth,
        mean_horizontal_m=float(horizontal.mean()),
        predicted_ce90_m=_mean([estimate.ce90 for estimate in group]),
        bias_east_m=float(bias[0]),
        bias_north_m=float(bias[1]),
        predicted_relative_ce90_m=_mean([estimate.relative_ce90 for estimate in group]),
        share_within_ce90=_share_within(horizontal, [estimate.ce90 for estimate in group]),
    )


def _positions(group: Sequence[Estimate], truth_enu: Array, frame: EnuFrame) -> Array:
    """Positions (n, 3) ENU; at the true height where there is none."""
    true_heights = frame.lla_from_enu(truth_enu)[:, 2]
    heights = [true if one.height is None else one.height for one, true in zip(group, true_heights, strict=True)]
    lla = np.array([(one.lat, one.lon, h) for one, h in zip(group, heights, strict=True)], dtype=np.float64)
    for estimate, row in zip(group, lla, strict=True):
        if not np.isfinite(row).all():
            raise InputError(
                f"the camera {estimate.image} counts as registered but has no position; check its line in cameras.csv"
            )
    return frame.enu_from_lla(lla[:, 0], lla[:, 1], lla[:, 2])


def _rmse_procrustes(positions: Array, truth: Array) -> float | None:
    """RMSE (m) after the best similarity: the shape error of the reconstruction itself; None if it is undetermined."""
    try:
        truth_from_found = umeyama(positions, truth)
    except (DegenerateGeometry, TooFewMatches):
        return None
    residuals = truth_from_found.apply(positions) - truth
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _share_within(errors: Array, limits: Sequence[float | None]) -> float | None:
    known = [error <= limit for error, limit in zip(errors, limits, strict=True) if limit is not None]
    return float(np.mean(known)) if known else None


def _require_common(estimates: Sequence[Estimate], truth_enu: Mapping[str, Array]) -> None:
    """A truth of part of the photos is evaluated where it is known; one of other photos is a mistake."""
    registered = [one.image for one in estimates if one.component is not None and one.registered]
    if registered and not any(image in truth_enu for image in registered):
        shown = ", ".join(registered[:NAMED_IN_MESSAGE]) + (", ..." if len(registered) > NAMED_IN_MESSAGE else "")
        raise InputError(
            f"the truth has none of the {len(registered)} registered images: {shown}; name them relative to the site's "
            "folder"
        )


def _require_unique(images: Sequence[str], where: str) -> None:
    doubles = [image for image, count in Counter(images).items() if count > 1]
    if doubles:
        raise InputError(f"{where} list the image {doubles[0]} more than once; keep one line")
