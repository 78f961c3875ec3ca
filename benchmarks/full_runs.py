# SPDX-License-Identifier: Apache-2.0
"""Whether predicted accuracies hold in whole runs: small simulated sites, from photos to cameras.

    python benchmarks/full_runs.py --out RUNS [--seeds 0 1 2 3] [--results FILE]

Twelve sites by default: every preset with four seeds, 18 photos of 480 pixels each, placed by `skymoor run`. The
error of a camera is its distance to where it was; without the reference's bias, which is known here, it is the relative
one. Errors count in standard deviations of what cameras.csv predicts: CE90 as a circle, LE90 as a line. Cameras of one
run err together, so twelve runs are twelve draws and not three hundred; each run has a line. Resumes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from skymoor.results.read import Result
from skymoor.results.tables import read_truth_csv

PRESETS = ("office-park", "industrial", "flooded")
SMALL = ("--radius-m", "45", "--airborne", "18", "--groups", "0", "--security", "0", "--photo-width", "480")
SMALL = (*SMALL, "--reference-width-m", "180", "--ortho-pixel-m", "0.5")
# Less to search, for time only; the flights are 50 to 80 m above ground.
FASTER = ("--set", "match.min_height_m=40", "--set", "match.max_height_m=110")
LEVELS = (0.5, 0.9, 0.99)
CIRCLE, LINE = float(np.sqrt(chi2.ppf(0.9, 2))), float(np.sqrt(chi2.ppf(0.9, 1)))  # CE90 and LE90 per sigma

Array = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    squared: dict[str, list[Array]] = {"relative": [], "absolute": []}
    for seed in arguments.seeds:
        for preset in PRESETS:
            row, found = case(arguments.out / f"{preset}-{seed}", preset, seed)
            rows.append(row)
            for name, values in found.items():
                squared[name].append(values)
            print(row, flush=True)
            summary = {name: told(values) for name, values in squared.items() if values}
            if arguments.results:
                arguments.results.write_text(json.dumps({"summary": summary, "runs": rows}, indent=1) + "\n")
    print(json.dumps(summary, indent=1))


def case(folder: Path, preset: str, seed: int) -> tuple[dict[str, Any], dict[str, Array]]:
    """Simulate and run one site; its line, and squared errors over predicted variances of its cameras."""
    site, out = folder / "site", folder / "run"
    skymoor("simulate", "--preset", preset, "--seed", str(seed), *SMALL, "--out", str(site), "--quiet")
    status = skymoor("run", str(site / "site.toml"), "--out", str(out), "--quiet", *FASTER)
    row: dict[str, Any] = {"preset": preset, "seed": seed, "exit": status}
    if status != 0:
        return row, {}
    result = Result.read(out)
    truth = {one.image: one for one in read_truth_csv(site / "truth.csv")}
    placed = [camera for camera in result.cameras if camera.lat is not None]
    enu = np.array([(c.east, c.north, c.up) for c in placed], float)
    true = np.array([(truth[c.image].lat, truth[c.image].lon, truth[c.image].height) for c in placed])
    error = enu - result.frame.enu_from_lla(*true.T)
    bias = np.array(json.loads((site / "truth.json").read_text())["bias_m"])
    relative = error - bias
    predicted = np.array([(c.ce90, c.le90, c.relative_ce90, c.relative_le90) for c in placed], float)
    found = {"absolute": nees(error, predicted[:, :2]), "relative": nees(relative, predicted[:, 2:])}
    row |= {
        "cameras": len(placed),
        "mean_absolute_m": float(np.linalg.norm(error, axis=1).mean()),
        "mean_relative_m": float(np.linalg.norm(relative, axis=1).mean()),
        "relative_horizontal_m": float(np.linalg.norm(relative[:, :2], axis=1).mean()),
        "relative_vertical_m": float(np.abs(relative[:, 2]).mean()),
        "relative_ce90_m": float(predicted[:, 2].mean()),
        "relative_le90_m": float(predicted[:, 3].mean()),
        "within_relative_ce90": float(np.mean(np.linalg.norm(relative[:, :2], axis=1) <= predicted[:, 2])),
        "within_relative_le90": float(np.mean(np.abs(relative[:, 2]) <= predicted[:, 3])),
        "nees_relative": float(found["relative"].mean() / 3),
        "nees_absolute": float(found["absolute"].mean() / 3),
        "false_alarm_probability": result.components[0].summary["diagnostics"].get("false_alarm_probability"),
    }
    return row, found


def nees(error: Array, predicted: Array) -> Array:
    """Squared errors (n,) of (n, 3) in standard deviations, by CE90 and LE90 (n, 2)."""
    horizontal, vertical = predicted[:, 0] / CIRCLE, predicted[:, 1] / LINE
    return np.asarray((error[:, 0] ** 2 + error[:, 1] ** 2) / horizontal**2 + error[:, 2] ** 2 / vertical**2)


def told(runs: list[Array]) -> dict[str, float]:
    """Shares of cameras within the ellipsoids, every run counting alike, and the mean of its squared errors over 3."""
    shares = {f"within_{level:.0%}": [float(np.mean(run < chi2.ppf(level, 3))) for run in runs] for level in LEVELS}
    return {
        "runs": len(runs),
        **{name: float(np.mean(values)) for name, values in shares.items()},
        "nees": float(np.mean([run.mean() / 3 for run in runs])),
    }


def skymoor(*arguments: str) -> int:
    """Exit status of a command, whose screen goes to no one."""
    program = Path(sys.executable).with_name("skymoor")
    return subprocess.run([program, *arguments], stdout=subprocess.DEVNULL, check=False).returncode


if __name__ == "__main__":
    main()
