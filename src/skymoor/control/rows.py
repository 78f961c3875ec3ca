# SPDX-License-Identifier: Apache-2.0
"""Residuals of control against a registration as tables have them, and how they compare with what was predicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # its parts load when they are first used

from skymoor.control.observations import Kind, Linear, Observations
from skymoor.geo import ce90_m
from skymoor.geo.accuracy import LE90_PER_SIGMA, PROBABILITY
from skymoor.types import Array

Use = Literal["check", "control", "wrong", "unusable"]
AXES = 3
BAR: Kind = "scale bar"


@dataclass(frozen=True)
class ControlRow:
    """One surveyed position or scale bar of a component, as the tables have it; None is what is not known.

    Attributes:
        use: "check"; "control" where it was used; "wrong" where the others contradict it; "unusable", see `reason`.
        n_photos: that show it.
        known_m: the surveyed position, east, north and up; of a scale bar its known length.
        residual_m: model minus known, east, north and up, before control is used; of a scale bar its length alone.
        sigma_m: predicted standard deviations of these, of model, reference and control together.
        distance: length of the residual in these (Mahalanobis).
        inside_ellipsoid, inside_ce90, inside_le90: whether it is within 90 percent of what was predicted.
        test, limit: value of data snooping and the largest that passes.
        after_m: the residual after control was used.
        ratio, ratio_sigma: of a scale bar, model by known length.
    """

    name: str
    kind: Kind
    use: Use
    n_photos: int
    known_m: tuple[float | None, ...] = ()
    residual_m: tuple[float | None, ...] = ()
    sigma_m: tuple[float | None, ...] = ()
    distance: float | None = None
    inside_ellipsoid: bool | None = None
    inside_ce90: bool | None = None
    inside_le90: bool | None = None
    test: float | None = None
    limit: float | None = None
    after_m: tuple[float | None, ...] = ()
    ratio: float | None = None
    ratio_sigma: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class Totals:
    """Of all surveyed positions but wrong ones: counts, RMSE and mean of residuals (east, north, up), and shares."""

    n: int
    n_with_height: int
    rmse_m: tuple[float | None, ...]
    mean_m: tuple[float | None, ...]
    inside_ellipsoid: float | None
    inside_ce90: float | None
    inside_le90: float | None


def row_of(observed: Observations, linear: Linear, prior: Array, k: int, *, heights_known: bool) -> ControlRow:
    """Block `k` of the observations at the registration, whose covariance (8, 8) is `prior`.

    Heights that nobody knows are not compared.
    """
    block = linear.rows[k]
    residual, design = -linear.misclosure[block], linear.design[block]
    predicted = design @ prior @ design.T + linear.errors[block, block]
    if k >= len(observed.places):
        return _bar_row(observed, k - len(observed.places), float(residual[0]), float(np.sqrt(predicted[0, 0])))
    one, size = observed.places[k], len(residual) if heights_known else 2
    residual, predicted = residual[:size], predicted[:size, :size]
    sigma = np.sqrt(np.diag(predicted))
    distance = float(np.sqrt(residual @ np.linalg.solve(predicted, residual)))
    return ControlRow(
        one.name,
        one.kind,
        "check",
        one.n_photos,
        row_values(one.xyz[: len(linear.misclosure[block])] + linear.misclosure[block], one.kind),
        row_values(residual, one.kind),
        row_values(sigma, one.kind),
        distance,
        inside_ellipsoid=bool(distance**2 <= scipy.stats.chi2.ppf(PROBABILITY, size)),
        inside_ce90=bool(np.hypot(*residual[:2]) <= ce90_m(predicted[:2, :2])),
        inside_le90=bool(abs(residual[2]) <= LE90_PER_SIGMA * sigma[2]) if size == AXES else None,
    )


def _bar_row(observed: Observations, k: int, residual: float, sigma: float) -> ControlRow:
    bar = observed.bars[k]
    return ControlRow(
        bar.name,
        BAR,
        "check",
        min(observed.ends[bar.a].n_photos, observed.ends[bar.b].n_photos),
        (bar.length_m,),
        (residual,),
        (sigma,),
        abs(residual) / sigma,
        inside_ellipsoid=abs(residual) <= LE90_PER_SIGMA * sigma,
        ratio=1 + residual / bar.length_m,
        ratio_sigma=sigma / bar.length_m,
    )


def row_values(values: Array, kind: Kind) -> tuple[float | None, ...]:
    """East, north and up of a position, None for a height that is not known; of a scale bar one number."""
    numbers: list[float | None] = [float(value) for value in values]
    return tuple(numbers if kind == BAR else numbers + [None] * (AXES - len(numbers)))


def totals_of(rows: Sequence[ControlRow]) -> Totals:
    """Of surveyed positions that are not wrong."""
    places = [row for row in rows if row.kind != BAR and row.residual_m and row.use != "wrong"]
    residuals = np.array([row.residual_m for row in places], dtype=np.float64).reshape(-1, AXES)
    counts = np.isfinite(residuals).sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = np.nansum(residuals, axis=0) / counts
        rmse = np.sqrt(np.nansum(residuals**2, axis=0) / counts)
    return Totals(
        len(places),
        int(counts[2]),
        tuple(_or_none(value) for value in rmse),
        tuple(_or_none(value) for value in mean),
        *(_share([getattr(row, f"inside_{name}") for row in places]) for name in ("ellipsoid", "ce90", "le90")),
    )


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _share(flags: Sequence[bool | None]) -> float | None:
    known = [flag for flag in flags if flag is not None]
    return sum(known) / len(known) if known else None


def in_metres(vector: Array) -> str:
    """A residual in words: of a position by its axes, of a scale bar its length."""
    if len(vector) == 1:
        return f"{vector[0]:+.2f} m"
    axes = zip(("east", "north", "up"), vector, strict=False)
    return " ".join(f"{axis} {value:+.2f}" for axis, value in axes if np.isfinite(value)) + " m"
