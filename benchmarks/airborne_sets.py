# SPDX-License-Identifier: Apache-2.0
"""Run sites end to end and print one table: errors against the truth, seconds per stage, peak memory.

    python benchmarks/airborne_sets.py --out RUNS SITE_FOLDER... [--decoy ORTHO DSM]

A site folder holds site.toml and truth.csv. With --decoy each site's photos are also run against a reference of another
place, where everything must be refused. Runs resume: give a fresh --out for honest times.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--decoy", nargs=2, type=Path, metavar=("ORTHO", "DSM"))
    options = parser.parse_args()
    for site in options.sites:
        out = options.out / site.name
        status = skymoor("run", str(site / "site.toml"), "--out", str(out))
        skymoor("evaluate", str(out), "--truth", str(site / "truth.csv"))
        report(site.name, out, status)
        if options.decoy:
            ortho, dsm = map(str, options.decoy)
            out = options.out / f"{site.name}-decoy"
            accuracy = ("--vertical-datum", "ellipsoid", "--ce90", "2.5", "--le90", "3.8")
            data = ("--airborne", str(site / "airborne"), "--ortho", ortho, "--dsm", dsm)
            report(f"{site.name} on the decoy", out, skymoor("run", *data, *accuracy, "--out", str(out)))


def skymoor(*arguments: str) -> int:
    return subprocess.run([Path(sys.executable).with_name("skymoor"), *arguments], stdout=subprocess.DEVNULL).returncode


def report(name: str, out: Path, status: int) -> None:
    summary = json.loads((out / "summary.json").read_text())
    airborne = summary["sets"][0]
    rows = {}
    if (out / "evaluation.json").exists():
        rows = {r["component"]: r for r in json.loads((out / "evaluation.json").read_text())["rows"]}
    print(f"\n{name}: exit {status}, {airborne['n_images_reconstructed']} of {airborne['n_images']} photos")
    for component in airborne["components"]:
        print(f"  component {component['component']}: {component['n_cameras']} cameras, {component['status']}")
        for remark in (component["reason"], component["calibration_note"]):
            if remark:
                print(f"    {remark}")
        print(f"    scores {component['diagnostics']}")
        show(rows.get(component["component"], {}))
    stages = summary["stages"]
    print("  seconds: " + ", ".join(f"{s['name']} {s['seconds']:.0f}" for s in stages))
    print(
        f"  total {sum(s['seconds'] for s in stages):.0f} s, peak {max(s['peak_mib'] for s in stages):.0f} MiB",
        flush=True,
    )


def show(row: dict[str, Any]) -> None:
    if row.get("mean_absolute_m") is None:
        return
    names = ("mean_absolute_m", "mean_horizontal_m", "mean_vertical_m", "mean_relative_m", "rmse_procrustes_m")
    print("    " + ", ".join(f"{name} {row[name]:.2f}" for name in names))
    share = 100 * row["mean_relative_m"] / row["standoff_m"]
    print(
        f"    standoff {row['standoff_m']:.0f} m, relative {share:.2f} % of it, M-dist {row['mahalanobis_of_mean']:.2f}"
    )
    print(f"    predicted CE90 {row['predicted_ce90_m']:.2f} m, LE90 {row['predicted_le90_m']:.2f} m")


if __name__ == "__main__":
    main()
