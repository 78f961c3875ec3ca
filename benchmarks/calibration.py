# SPDX-License-Identifier: Apache-2.0
"""Whether predicted accuracies hold: many simulated registrations whose errors are known.

    python benchmarks/calibration.py [--count 400] [--results FILE] [--plot FILE]

Each registration is one of 300 to 3000 matches over a site of 60 to 300 metres, with relief, a share of wrong matches,
white noise, and errors that are alike over 3 to 60 metres, horizontally and in height; of a reference with a bias drawn
from its covariance; and of cameras whose focal length and shape are off by what the reconstruction says of itself. The
matches go through the product's own consensus, adjustment and covariance. Told are, for camera positions, the share of
errors within the predicted 50, 90 and 99 percent ellipsoids, and the mean squared error over what was predicted.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from skymoor.geo import EnuFrame, Grid
from skymoor.geometry import Similarity
from skymoor.registration import camera_accuracy, register
from skymoor.types import Calibration, Matches2D, Matches3D, Reference

Array = NDArray[np.float64]
LEVELS = (0.5, 0.9, 0.99)
REFERENCE = np.diag([1.0, 1.0, 5.4])


@dataclass(frozen=True)
class Outcome:
    """Errors of one registration's cameras in standard deviations, squared, and what was drawn for it."""

    relative: float
    total: float
    relative_of_mean: float
    drawn: dict[str, float]


def smooth_field(rng: np.random.Generator, plan: Array, range_m: float, side_m: float) -> Array:
    """A random field (n,) of variance 1 at places (n, 2), alike over about `range_m`."""
    pixel = range_m / 4
    shape = (int(side_m / pixel) + 40,) * 2
    field = gaussian_filter(rng.normal(size=shape), 2.0, mode="wrap")
    field /= field.std() if field.size < 4000 else 1 / (2 * 2.0 * np.sqrt(np.pi))
    return np.asarray(map_coordinates(field, ((plan + side_m / 2) / pixel + 20).T, order=1))


def simulated(rng: np.random.Generator) -> Outcome | None:
    """One registration; None where nothing could be estimated."""
    side_m, n = rng.uniform(60, 300), int(10 ** rng.uniform(2.5, 3.5))
    drawn = {
        "side_m": side_m,
        "n": float(n),
        "white_m": rng.uniform(0.05, 0.3),
        "alike_m": rng.uniform(0.05, 0.35),
        "range_m": 10 ** rng.uniform(0.5, 1.8),
        "wrong": rng.uniform(0, 0.5),
    }
    height_m = rng.uniform(40, 120)
    turn = Rotation.from_euler("zyx", [rng.uniform(0, 360), *rng.normal(0, 0.7, 2)], degrees=True).as_matrix()
    truth = Similarity(height_m, turn, rng.uniform(-50, 50, 3))
    plan = rng.uniform(-side_m / 2, side_m / 2, (n, 2))
    relief = 2 * smooth_field(rng, plan, 30.0, side_m) + np.where(rng.uniform(size=n) < 0.2, rng.uniform(3, 12, n), 0)
    ground = np.column_stack([plan, relief])
    xyz_level = truth.inverse().apply(ground + truth.translation)
    errors = drawn["white_m"] * rng.normal(size=(n, 3))
    for axis in range(3):
        factor = 1.5 if axis == 2 else 1.0
        errors[:, axis] += factor * drawn["alike_m"] * smooth_field(rng, plan, drawn["range_m"], side_m)
    bias = rng.multivariate_normal(np.zeros(3), REFERENCE)
    xyz_enu = truth.apply(xyz_level) + errors + bias
    wrong = rng.uniform(size=n) < drawn["wrong"]
    xyz_enu[wrong] += rng.normal(scale=[20, 20, 5], size=(int(wrong.sum()), 3))
    nothing = np.zeros((n, 2))
    matches = Matches3D(xyz_level, xyz_enu, Matches2D(nothing, nothing, np.ones(n)))
    found = register(matches, 0.5, rng=rng)
    if found.enu_from_level is None or found.covariance is None:
        return None
    return _outcome(rng, found, truth, bias, height_m, side_m, drawn)


def _outcome(rng, found, truth, bias, height_m, side_m, drawn):  # type: ignore[no-untyped-def]
    """Cameras over the site, wrong by focal length and shape as much as they say, placed by the registration."""
    count = 40
    centres = np.column_stack([rng.uniform(-side_m / 2, side_m / 2, (count, 2)), np.full(count, height_m)])
    focal_sigma, shape_m = rng.uniform(0, 0.01), rng.uniform(0.01, 0.2)
    true_enu = centres + truth.translation
    believed = centres + np.column_stack([np.zeros((count, 2)), focal_sigma * rng.normal() * centres[:, 2]])
    # The product believes formal covariances to be half of the truth; here they are the truth.
    from skymoor.registration.covariance import SHAPE_FACTOR

    believed = believed + shape_m * rng.normal(size=(count, 3))
    shape = np.tile(np.eye(3) * (shape_m / SHAPE_FACTOR) ** 2, (count, 1, 1))
    placed = found.enu_from_level.apply(truth.inverse().apply(believed + truth.translation))
    reference = Reference(
        EnuFrame(0.0, 0.0, 0.0), Grid(0.0, 0.0, 0.5, (1, 1)), np.zeros((1, 1, 3), np.uint8), np.ones((1, 1), bool),
        np.zeros((1, 1), np.float32), REFERENCE, 0.5,
    )  # fmt: skip
    calibration = Calibration(
        shared_intrinsics=True,
        focal_px=1000.0,
        focal_sigma_ratio=0.0,
        focal_low_ratio=1 - focal_sigma,
        focal_high_ratio=1 + focal_sigma,
        uncertain=False,
    )
    accuracy = camera_accuracy(found, placed, reference, calibration, shape)
    error = placed - true_enu
    relative, total = error - bias, error
    one = int(rng.integers(count))

    def squared(e: Array, covariance: Array) -> float:
        return float(e @ np.linalg.solve(covariance, e))

    return Outcome(
        squared(relative[one], accuracy.relative[one]),
        squared(total[one], accuracy.total[one]),
        float(np.linalg.norm(relative[one])),
        {**drawn, "reach_m": found.diagnostics["errors_reach_m"], "cells": found.diagnostics["cells"]},
    )


def told(squared: Array) -> dict[str, float]:
    """Coverage of the ellipsoids, and mean squared error over the predicted one (1 is right)."""
    shares = {f"within_{level:.0%}": float(np.mean(squared < chi2.ppf(level, 3))) for level in LEVELS}
    return {**shares, "nees": float(np.mean(squared) / 3), "median_nees": float(np.median(squared) / chi2.median(3))}


def plot(relative: Array, total: Array, path: Path) -> None:
    """How many errors lie within the ellipsoids, against how many should."""
    import plotly.graph_objects as go

    levels = np.linspace(0.01, 0.99, 99)
    figure = go.Figure(layout={"template": "plotly_white", "width": 560, "height": 460})
    for share, name in ((0.05, None), (0.95, "90 % of right predictions")):
        edge = binom.ppf(share, len(relative), levels) / len(relative)
        band = {"line": {"width": 0}, "fill": "tonexty" if name else None, "fillcolor": "lightgrey"}
        figure.add_scatter(x=levels, y=edge, name=name, mode="lines", showlegend=bool(name), **band)
    for name, squared in (("relative to the reference", relative), ("absolute", total)):
        shares = [float(np.mean(squared < chi2.ppf(level, 3))) for level in levels]
        figure.add_scatter(x=levels, y=shares, name=name, mode="lines")
    figure.add_scatter(x=[0, 1], y=[0, 1], name="right", line={"dash": "dot", "color": "grey"}, mode="lines")
    figure.update_layout(xaxis_title="predicted share", yaxis_title="share of errors within")
    figure.update_layout(legend={"x": 0.45, "y": 0.05}, margin={"l": 60, "r": 10, "t": 10, "b": 50})
    figure.write_html(path, config={"displayModeBar": False}) if path.suffix == ".html" else figure.write_image(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    outcomes = [simulated(np.random.default_rng([7, seed])) for seed in range(arguments.count)]
    found = [outcome for outcome in outcomes if outcome is not None]
    relative, total = (np.array([getattr(o, name) for o in found]) for name in ("relative", "total"))
    rows = {"registrations": len(found), "relative": told(relative), "absolute": told(total)}
    far = np.array([o.drawn["range_m"] for o in found]) > 20
    rows |= {"relative, alike over more than 20 m": told(relative[far]), "relative, over less": told(relative[~far])}
    for name, row in rows.items():
        print(name, row)
    if arguments.results:
        arguments.results.write_text(json.dumps(rows, indent=1) + "\n")
    if arguments.plot:
        plot(relative, total, arguments.plot)


if __name__ == "__main__":
    main()
