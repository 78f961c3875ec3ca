# SPDX-License-Identifier: Apache-2.0
"""Distances on the surface, with the accuracy that a registration predicts for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skymoor.engines.raycast import RayCaster
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.viewer.surfaces import Layer
from skymoor.types import Array

LEAST_RESIDUALS = 10  # of heights as well, for a covariance
NEAREST_M = 1e-6  # points that are nearer have no direction between them


@dataclass(frozen=True, eq=False)
class RelativeErrors:
    """What two points of a surface do not share.

    Attributes:
        scale_sigma: relative, of the whole model.
        height_sigma: relative, of heights against lengths in plan: that of the focal length.
        point_covariance: (3, 3) m^2 of each point by itself.
    """

    scale_sigma: float
    height_sigma: float
    point_covariance: Array


@dataclass(frozen=True)
class Measurement:
    """Metres between two points; nine of ten errors are smaller than `error_90_m`, which is None where unknown."""

    distance_m: float
    horizontal_m: float
    height_m: float
    error_90_m: float | None


def relative_errors(result: Result, component: ComponentSummary) -> RelativeErrors | None:
    """Of a registered component's surface; None where summary.json has no accuracy of it.

    Runs of versions that kept no covariance of the transform have one of a point: both ends then err by it, as if they
    had nothing in common, which is too much for points that are close to each other.
    """
    surface = component.summary.get("surface_accuracy")
    if not surface:
        return None
    height = float((component.summary.get("calibration") or {}).get("focal_sigma_ratio") or 0.0)
    similarity = surface.get("similarity_covariance")
    if similarity is None:
        return RelativeErrors(0.0, height, np.array(surface["relative_covariance_m2"], dtype=np.float64))
    return RelativeErrors(float(np.sqrt(similarity[0][0])), height, _point_covariance(result, component))


def _point_covariance(result: Result, component: ComponentSummary) -> Array:
    """(3, 3) m^2 of one point by itself, by the residuals of the inliers; heights are known at some of them only."""
    residuals = result.residuals(component)
    found = np.zeros((3, 3))
    if residuals is None:
        return found
    whole = residuals[np.isfinite(residuals).all(axis=1)]
    if len(whole) >= LEAST_RESIDUALS:
        return np.asarray(whole.T @ whole / len(whole), dtype=np.float64)
    plan = residuals[np.isfinite(residuals[:, :2]).all(axis=1), :2]
    found[:2, :2] = plan.T @ plan / max(len(plan), 1)
    found[2, 2] = float((component.summary.get("height_verdict") or {}).get("spread_m") or 0.0) ** 2
    return found


def worst_errors(result: Result) -> RelativeErrors | None:
    """The largest of all registered components with a surface; None where one of them has no confirmed heights."""
    placed = [one for one in result.components if one.registered]
    found = [relative_errors(result, one) for one in placed]
    known = [one for one in found if one is not None]
    if not known or any(one.heights == "NOT_CONFIRMED" for one in placed):
        return None
    return RelativeErrors(
        max(one.scale_sigma for one in known),
        max(one.height_sigma for one in known),
        max((one.point_covariance for one in known), key=lambda covariance: float(np.trace(covariance))),
    )


def measured(start: Array, end: Array, errors: RelativeErrors | None) -> Measurement:
    """The distance between two points (3,) in ENU metres of the same surface.

    A shift and a rotation of the whole model leave distances as they are, so of the similarity only the scale counts:

        sigma^2 = (d sigma_scale)^2 + (h^2 / d sigma_height)^2 + 2 u^T C_point u,   u = (end - start) / d, h = d u_up

    The error of a distance of zero is that of the worst direction.
    """
    between = np.asarray(end, dtype=np.float64) - start
    distance, height = float(np.linalg.norm(between)), float(between[2])
    error = None
    if errors is not None and distance > NEAREST_M:
        point = float(between @ errors.point_covariance @ between) / distance**2
        stretched = (distance * errors.scale_sigma) ** 2 + (height**2 / distance * errors.height_sigma) ** 2
        error = LE90_PER_SIGMA * float(np.sqrt(stretched + 2 * point))
    elif errors is not None:
        error = LE90_PER_SIGMA * float(np.sqrt(2 * np.linalg.eigvalsh(errors.point_covariance)[-1]))
    return Measurement(distance, float(np.hypot(between[0], between[1])), height, error)


class Picker:
    """Finds where a ray meets the surfaces; the triangles of each are prepared once."""

    def __init__(self) -> None:
        self._casters: dict[str, tuple[Layer, RayCaster]] = {}

    def hit(self, origin: Sequence[float], direction: Sequence[float], layers: Iterable[Layer]) -> Array | None:
        """Where the ray (3,), (3,) first meets one of the layers that have triangles, (3,); None where it meets none.

        Raises `BackendUnavailable` without Open3D.
        """
        start, along = (np.array([one], dtype=np.float32) for one in (origin, direction))
        reached = [float(self._caster(layer).cast(start, along)[0]) for layer in layers if layer.faces is not None]
        nearest = min(reached, default=np.inf)
        return None if not np.isfinite(nearest) else np.asarray(start[0] + nearest * along[0], dtype=np.float64)

    def _caster(self, layer: Layer) -> RayCaster:
        known = self._casters.get(layer.name)
        if known is None or known[0] is not layer:  # a finer one has come
            assert layer.faces is not None
            known = self._casters[layer.name] = (layer, RayCaster(layer.points, layer.faces))
        return known[1]
