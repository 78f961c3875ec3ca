# SPDX-License-Identifier: Apache-2.0
"""The two tables of Bredvik, Richardson and Crispell (2025), with our rows on simulated sites under the paper's.

    python benchmarks/paper_tables.py --out RUNS [--seeds 0 1] [--presets office-park industrial flooded]

Each case is a site of the paper's size (50 airborne photos; two ground groups of 11 and eight security cameras, or one
group of 50 at the industrial site), simulated, run and evaluated by the skymoor commands, with a log beside it.
Everything resumes: start it in the background, look at the logs, start it again. A case that failed is listed as such.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import time
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.geo import EnuFrame
from skymoor.results.tables import read_cameras_csv, read_truth_csv

PAPER_SITE = {"office-park": "A01", "industrial": "M07", "flooded": "A08"}
# Site: mean absolute, M-dist, mean relative, standoff, (CE90, LE90).
PAPER_AIRBORNE = {
    "A01": (1.83, 1.2, 1.42, 148, (2.13, 3.82)),
    "M07": (0.83, 0.4, 0.67, 113, (3.11, 3.71)),
    "A08": (3.40, 3.9, 1.71, 67, (2.85, 3.84)),
}
# Site: subgraphs, mean absolute, M-dist, mean relative, median relative, (CE90, LE90).
PAPER_GROUND = {
    "A01": (2, 3.00, 2.0, 0.91, 0.62, (2.13, 3.82)),
    "M07": (1, 0.81, 0.3, 0.39, 0.05, (3.11, 3.71)),
    "A08": (2, 6.03, 2.9, 4.50, 1.2, (2.85, 3.84)),
}
GROUPS = {
    "office-park": ("2", "11", "8"),
    "industrial": ("1", "50", "0"),
    "flooded": ("2", "11", "8"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--presets", nargs="+", choices=list(PAPER_SITE), default=list(PAPER_SITE))
    parser.add_argument("--width", type=int, default=640, help="of the photos, pixels")
    parser.add_argument("--results", type=Path, help="a JSON file for the rows, with machine, date and commit")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for seed in options.seeds:
        for preset in options.presets:
            rows += case(options.out / f"{preset}-{seed}", preset, seed, options.width)
    print_airborne([row for row in rows if row["set"] == "airborne"])
    print_ground([row for row in rows if row["set"] != "airborne"])
    if options.results:
        options.results.write_text(json.dumps({**provenance(options.width), "rows": rows}, indent=1) + "\n")


def case(folder: Path, preset: str, seed: int, width: int) -> list[dict[str, Any]]:
    """One row per set and component of a site; a row without errors where nothing was registered."""
    folder.mkdir(parents=True, exist_ok=True)
    groups, photos, security = GROUPS[preset]
    site, result, started = folder / "site", folder / "result", time.monotonic()
    with (folder / "log.txt").open("a") as log:
        size = ("--groups", groups, "--group-photos", photos, "--security", security, "--photo-width", str(width))
        made = skymoor(log, "simulate", "--preset", preset, "--seed", str(seed), *size, "--out", str(site))
        status = made or skymoor(log, "run", str(site / "site.toml"), "--out", str(result))
        if status not in (0, 3) or skymoor(log, "evaluate", str(result), "--truth", str(site / "truth.csv")):
            print(f"{folder.name}: exit {status}, see {folder / 'log.txt'}", flush=True)
            return [{"preset": preset, "seed": seed, "set": "airborne", "status": f"exit {status}"}]
    print(f"{folder.name}: exit {status} after {time.monotonic() - started:.0f} s", flush=True)
    truth = json.loads((site / "truth.json").read_text())
    summary = json.loads((result / "summary.json").read_text())
    common = {
        "preset": preset,
        "seed": seed,
        "bias_m": truth["bias_m"],
        "seconds": sum(stage["seconds"] for stage in summary["stages"]),
        "peak_mib": max(stage["peak_mib"] for stage in summary["stages"]),
    }
    evaluated = json.loads((result / "evaluation.json").read_text())["rows"]
    rows = [{**common, **row, **split(site, result, row, truth), **evidence(summary, row)} for row in evaluated]
    missing = [item for item in summary["sets"] if not item["components"]]
    return rows + [
        {**common, "set": item["set"], "status": item["status"], "reason": item["reason"]} for item in missing
    ]


def evidence(summary: dict[str, Any], row: dict[str, Any]) -> dict[str, Any]:
    """How sure a component's place was, by its own account, and why it was refused; and what finding it cost."""
    (found,) = [item for item in summary["sets"] if item["set"] == row["set"]]
    (component,) = [item for item in found["components"] if item["component"] == row["component"]]
    seconds = [s["seconds"] for s in summary["stages"] if s["name"] == f"{row['set']}-{row['component']}.search"]
    names = ("contrast", "second_contrast", "guesses", "walls_seen")
    told = {name: component["diagnostics"].get(name) for name in names}
    return {**told, "reason": component["reason"], "search_s": sum(seconds)}


def split(site: Path, result: Path, row: dict[str, Any], truth: dict[str, Any]) -> dict[str, float | None]:
    """The mean error of a component, and what is left of it without the bias that the reference was given."""
    if row["status"] != "REGISTERED":
        return {}
    origin = truth["enu_origin"]
    frame = EnuFrame(origin["lat"], origin["lon"], origin["height"])
    true = {t.image: frame.enu_from_lla(t.lat, t.lon, t.height).ravel() for t in read_truth_csv(site / "truth.csv")}
    errors = np.array(
        [
            frame.enu_from_lla(e.lat, e.lon, e.height).ravel() - true[e.image]
            for e in read_cameras_csv(result / "cameras.csv")
            if (e.set, e.component) == (row["set"], row["component"]) and e.lat is not None
        ]
    )
    bias = np.array(truth["bias_m"])
    own = errors - bias
    return {
        "bias_length_m": float(np.linalg.norm(bias)),
        "own_mean_absolute_m": float(np.linalg.norm(own, axis=1).mean()),
        "own_horizontal_m": float(np.linalg.norm(own[:, :2], axis=1).mean()),
        "own_vertical_m": float(np.abs(own[:, 2]).mean()),
    }


def skymoor(log: Any, *arguments: str) -> int:
    command = [str(Path(sys.executable).with_name("skymoor")), *arguments]
    return subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode


def print_airborne(rows: list[dict[str, Any]]) -> None:
    headings = ("airborne", "cameras", "status", "mean absolute", "reference's bias", "own", "M-dist", "mean relative")
    table = []
    for preset, site in PAPER_SITE.items():
        absolute, m_dist, relative, standoff, accuracy = PAPER_AIRBORNE[site]
        share = f"{100 * relative / standoff:.2f}"
        table.append([f"paper, {site}", "", "", absolute, "", "", m_dist, relative, share, standoff, accuracy, "", ""])
        for row in (row for row in rows if row["preset"] == preset):
            known = row.get("mean_absolute_m") is not None
            table.append([f"{preset} {row['seed']}", row.get("n_cameras", 0), row["status"]])
            if known:
                table[-1] += [
                    *(f"{row[name]:.2f}" for name in ("mean_absolute_m", "bias_length_m", "own_mean_absolute_m")),
                    *(f"{row[name]:.2f}" for name in ("mahalanobis_of_mean", "mean_relative_m")),
                    f"{100 * row['mean_relative_m'] / row['standoff_m']:.2f}",
                    f"{row['standoff_m']:.0f}",
                    accuracy,
                    f"({row['predicted_ce90_m']:.2f}, {row['predicted_le90_m']:.2f})",
                    f"{row['seconds']:.0f}",
                ]
    print_table((*headings, "% of standoff", "standoff", "CE90, LE90 of the DSM", "predicted", "s"), table)


def print_ground(rows: list[dict[str, Any]]) -> None:
    headings = ("ground", "cameras", "status", "mean absolute", "own", "M-dist", "mean relative", "median relative")
    headings = (*headings, "contrast, next", "s", "reason")
    names = ("mean_absolute_m", "own_mean_absolute_m", "mahalanobis_of_mean", "mean_relative_m", "median_relative_m")
    table = []
    for preset, site in PAPER_SITE.items():
        subgraphs, absolute, m_dist, relative, median, _ = PAPER_GROUND[site]
        table.append([f"paper, {site}", f"{subgraphs} subgraphs", "", absolute, "", m_dist, relative, median])
        for row in (row for row in rows if row["preset"] == preset):
            name = " ".join(str(row[key]) for key in ("preset", "seed", "set", "component") if key in row)
            table.append([name, row.get("n_cameras", 0), row["status"]])
            if row.get("mean_absolute_m") is not None:
                table[-1] += [f"{row[key]:.2f}" for key in names]
            table[-1] += [""] * (len(names) + 3 - len(table[-1]))
            if row.get("contrast") is not None:
                table[-1] += [f"{row['contrast']:.1f}, {row['second_contrast'] or 0:.1f}", f"{row['search_s']:.0f}"]
                table[-1].append(row["reason"])
    print_table(headings, table)


def print_table(headings: tuple[str, ...], rows: list[list[Any]]) -> None:
    """Markdown; short rows end empty."""
    print("\n| " + " | ".join(headings) + " |\n|" + "---|" * len(headings))
    for row in rows:
        print("| " + " | ".join(map(str, row + [""] * (len(headings) - len(row)))) + " |")


def provenance(photo_width: int | None = None) -> dict[str, Any]:
    """Where and when, with which code, and how wide the photos were."""
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True).stdout.strip()
    machine = f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}"
    made = {"machine": machine, "date": date.today().isoformat(), "commit": commit}
    return made if photo_width is None else {**made, "photo_width": photo_width}


if __name__ == "__main__":
    main()
