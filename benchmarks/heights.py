# SPDX-License-Identifier: Apache-2.0
"""Whether positions and heights can be believed whatever the elevation model is: whole runs on variants of one DSM.

    python benchmarks/heights.py --out RUNS [--simulated] [--sites FOLDER ...] [--variants given,10m,...] [--decoys]

A site is a folder with site.toml, truth.csv and the reference; `--simulated` adds two small ones of each preset.
Variants are those of `height_variants.py`, `given` (the DSM as it is) and `none` (no DSM). The stated accuracy stays
that of the given reference, also where it is untrue: the program must notice. The runs of a site share what does not
depend on the reference. With `--decoys` the photos are run on the next site's reference instead, where every
registration is false. A line of JSON for each run, then a summary. Resumes: runs that ended with a verdict are kept
unless `--again`; what a failed run says is in its log.txt.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parent))
from full_runs import FASTER, SMALL, skymoor
from height_variants import VARIANTS, Elevation

from skymoor.evaluate import Truth
from skymoor.geo import ce90_m, covariance_from_ce90_le90
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.tables import CameraRow, read_truth_csv
from skymoor.simulate.options import Preset

ALL = ("given", *VARIANTS, "none")
DECOYS = ("given", "flat")
SEEDS = (0, 1)
WRONG_LE90 = 2.0  # heights that err by more than this many LE90 are wrong
WRONG_CE90 = 3.0  # positions that err by more than this many CE90 are of another place

Array = NDArray[np.float64]
Row = dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sites", type=Path, nargs="+", default=[])
    parser.add_argument("--simulated", action="store_true")
    parser.add_argument("--presets", nargs="+", choices=get_args(Preset), default=list(get_args(Preset)))
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--variants", type=lambda text: text.split(","))
    parser.add_argument("--decoys", action="store_true", help="run on the reference of the next site")
    parser.add_argument("--set", action="append", default=[], help="an option of the runs on --sites, NAME=VALUE")
    parser.add_argument("--again", action="store_true", help="run finished ones again, from the cache where it holds")
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    variants = arguments.variants or (DECOYS if arguments.decoys else ALL)
    if unknown := set(variants) - set(ALL):
        parser.error(f"no such variant: {', '.join(sorted(unknown))}; there are {', '.join(ALL)}")
    sites = list(all_sites(arguments))
    if len(sites) < 1 + arguments.decoys:
        parser.error("give --simulated or --sites, at least two sites for --decoys")
    rows: list[Row] = []
    for k, (site, options) in enumerate(sites):
        other = sites[(k + 1) % len(sites)][0] if arguments.decoys else site
        for variant in sorted(variants, key=ALL.index):
            rows.append(case(arguments.out, site, other, variant, options, again=arguments.again))
            print(json.dumps(rows[-1]), flush=True)
            summary = told_decoys(rows) if arguments.decoys else told(rows)
            if arguments.results:
                arguments.results.write_text(json.dumps({"summary": summary, "runs": rows}, indent=1) + "\n")
    print(json.dumps(summary, indent=1))


def all_sites(arguments: argparse.Namespace) -> Iterable[tuple[Path, list[str]]]:
    """Folders of sites with the options of their runs; neighbours are of different presets."""
    for seed in arguments.seeds if arguments.simulated else ():
        for preset in arguments.presets:
            folder = arguments.out / "sites" / f"{preset}-{seed}"
            if skymoor("simulate", "--preset", preset, "--seed", str(seed), *SMALL, "--out", str(folder), "--quiet"):
                raise SystemExit(f"{folder}: was not simulated")
            yield folder, list(FASTER)
    for folder in arguments.sites:
        yield folder, [part for option in arguments.set for part in ("--set", option)]


def case(out: Path, site: Path, other: Path, variant: str, options: list[str], *, again: bool) -> Row:
    """Run the photos of a site on a variant of the reference of that or of another one; what came of it."""
    name = site.name if other == site else f"{site.name}-on-{other.name}"
    folder = out / ("runs" if other == site else "decoys") / name / variant
    kept = folder / "row.json"
    if kept.exists() and not again:
        return dict(json.loads(kept.read_text()))
    folder.mkdir(parents=True, exist_ok=True)
    write_site(folder, site, other, variant)
    for before in (out / "runs" / site.name / "given", folder.parent / "given"):
        share_stages(before / "run", folder / "run")
    started = time.monotonic()
    with (folder / "log.txt").open("w") as log:
        program = Path(sys.executable).with_name("skymoor")
        command = [str(program), "run", str(folder / "site.toml"), "--out", str(folder / "run"), "--quiet", *options]
        status = subprocess.run(command, stdout=log, stderr=log, check=False).returncode
    row: Row = {"site": site.name, "variant": variant, "exit": status}
    row |= {} if other == site else {"reference": other.name}
    row |= {"seconds": round(time.monotonic() - started, 1), "components": []}
    if status in (0, 3):
        row["components"] = components(Result.read(folder / "run"), site, measured=other == site)
        kept.write_text(json.dumps(row) + "\n")
    return row


def write_site(folder: Path, site: Path, other: Path, variant: str) -> None:
    """The variant's DSM and site.toml: photos of `site`, reference of `other`, no ground photos."""
    table, theirs = (tomllib.loads((one / "site.toml").read_text(encoding="utf-8")) for one in (site, other))
    reference = theirs["reference"]
    ortho, dsm = ((other / reference[key]).resolve() for key in ("ortho", "dsm"))
    lines = [f'name = "{site.name}, {variant}"', "[reference]", f"ortho = {json.dumps(str(ortho))}"]
    stated = {key: reference[key] for key in ("vertical_datum", "covariance", "ce90", "le90") if key in reference}
    if variant == "none":
        known = "covariance" in stated
        covariance = stated["covariance"] if known else covariance_from_ce90_le90(stated["ce90"], stated["le90"])
        stated = {"ce90": ce90_m(covariance)}
    else:
        if variant in VARIANTS:
            elevation = Elevation.read(dsm)
            dsm = folder.resolve() / "dsm.tif"
            elevation.write(dsm, *VARIANTS[variant](elevation.heights, elevation.pixel_m))
        lines.append(f"dsm = {json.dumps(str(dsm))}")
    lines += [f"{key} = {json.dumps(value)}" for key, value in stated.items()]
    lines += ["[airborne]", f"images = {json.dumps(str((site / table['airborne']['images']).resolve()))}"]
    lines += ["[options]", *flat_options(table.get("options", {}))]
    (folder / "site.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def flat_options(table: Row, prefix: str = "") -> list[str]:
    """Lines of TOML with dotted keys."""
    lines: list[str] = []
    for key, value in table.items():
        dotted = f"{prefix}{key}"
        lines += flat_options(value, f"{dotted}.") if isinstance(value, dict) else [f"{dotted} = {json.dumps(value)}"]
    return lines


def share_stages(finished: Path, run: Path) -> None:
    """Begin with the cache of a finished run, as hard links; what does not fit the other reference is computed."""
    if (finished / "stages").is_dir() and finished != run and not (run / "stages").exists():
        shutil.copytree(finished / "stages", run / "stages", copy_function=os.link)


def components(result: Result, site: Path, *, measured: bool) -> list[Row]:
    """What is said of each airborne component, and, where it is registered and `measured`, what is true."""
    truths = {_key(one.image): one for one in read_truth_csv(site / "truth.csv")}
    made = site / "truth.json"
    bias = np.array(json.loads(made.read_text())["bias_m"]) if made.exists() else None
    rows = []
    for found in result.components:
        if found.image_set != "airborne":
            continue
        row = said(found)
        if found.registered and measured:
            cameras = [c for c in result.registered_cameras if c.set == "airborne" and c.component == found.index]
            pairs = [(c, truths[_key(c.image)]) for c in cameras if _key(c.image) in truths]
            row |= errors(pairs, result, bias) if pairs else {}
        rows.append(row)
    return rows


def said(found: ComponentSummary) -> Row:
    """What summary.json says of a component; None for what it does not say."""
    predicted = ("ce90_m", "le90_m", "relative_ce90_m", "relative_le90_m")
    names = ["n_cameras", "status", "reason", "heights", "height_scale", "height_scale_sigma"]
    names += [f"predicted_{name}" for name in predicted]
    verdict = found.summary.get("height_verdict") or {}
    return {name: found.summary.get(name) for name in names} | {"height_reason": verdict.get("reason")}


def errors(pairs: list[tuple[CameraRow, Truth]], result: Result, bias: Array | None) -> Row:
    """Errors of cameras in metres, means, and shares within the predictions; None where there is no height."""
    heights = np.array([np.nan if c.height is None else c.height for c, _ in pairs])
    known = bool(np.isfinite(heights).all())
    truth = np.array([(t.lat, t.lon, t.height) for _, t in pairs])
    lat, lon = np.array([(c.lat, c.lon) for c, _ in pairs], float).T
    error = result.frame.enu_from_lla(lat, lon, np.where(np.isfinite(heights), heights, truth[:, 2]))
    error = error - result.frame.enu_from_lla(*truth.T)
    row: Row = {
        "horizontal_m": float(np.linalg.norm(error[:, :2], axis=1).mean()),
        "height_m": float(error[:, 2].mean()) if known else None,
        "absolute_height_m": float(np.abs(error[:, 2]).mean()) if known else None,
        **within("", error, [(c.ce90, c.le90) for c, _ in pairs]),
    }
    if bias is not None:
        relative = error - bias
        row["relative_horizontal_m"] = float(np.linalg.norm(relative[:, :2], axis=1).mean())
        row["relative_height_m"] = float(relative[:, 2].mean()) if known else None
        row |= within("relative_", relative, [(c.relative_ce90, c.relative_le90) for c, _ in pairs])
    return row


def within(prefix: str, error: Array, predicted: list[tuple[float | None, float | None]]) -> Row:
    """Shares of errors (n, 3) within CE90 and LE90; None where nothing is predicted."""
    ce90, le90 = np.array(predicted, float).T
    found = {"ce90": (np.linalg.norm(error[:, :2], axis=1), ce90), "le90": (np.abs(error[:, 2]), le90)}
    return {
        f"within_{prefix}{name}": float(np.mean(size <= limit)) if np.isfinite(limit).all() else None
        for name, (size, limit) in found.items()
    }


def told(rows: list[Row]) -> Row:
    """Counts by variant, and over all registered components how many cameras lie within the predictions."""
    by_variant: Row = {}
    for variant in dict.fromkeys(row["variant"] for row in rows):
        mine = [row for row in rows if row["variant"] == variant]
        parts = [part for row in mine for part in row["components"]]
        placed = [part for part in parts if part["status"] == "REGISTERED"]
        verdicts = [part["heights"] or "no verdict" for part in placed]
        by_variant[variant] = {
            "runs": len(mine),
            "failed": sum(row["exit"] not in (0, 3) for row in mine),
            "registered": len(placed),
            "refused": len(parts) - len(placed),
            "registered elsewhere": sum(elsewhere(part) for part in placed),
            "heights": {verdict: verdicts.count(verdict) for verdict in sorted(set(verdicts))},
            "wrong heights confirmed": sum(wrong_height(part) for part in placed if part["heights"] == "CONFIRMED"),
            **coverage(placed),
        }
    # Nothing in the photos tells of a constant offset.
    summary: Row = {"variants": by_variant}
    for name, left_out in (("all", ()), ("all but offset", ("offset",))):
        kept = [row for row in rows if row["variant"] not in left_out]
        parts = [part for row in kept for part in row["components"] if part["status"] == "REGISTERED"]
        wrong = sum(wrong_height(part) for part in parts if part["heights"] == "CONFIRMED")
        summary[name] = {"registered": len(parts), "wrong heights confirmed": wrong, **coverage(parts)}
    return summary


def coverage(parts: list[Row]) -> Row:
    """Mean shares of cameras within the predictions, every component counting alike."""
    names = ("within_ce90", "within_le90", "within_relative_ce90", "within_relative_le90")
    values = {name: [part[name] for part in parts if part.get(name) is not None] for name in names}
    return {name: round(float(np.mean(found)), 3) if found else None for name, found in values.items()}


def elsewhere(part: Row) -> bool:
    """Whether a registered component is nowhere near where it was."""
    return bool(part.get("horizontal_m", 0.0) > WRONG_CE90 * part["predicted_ce90_m"])


def wrong_height(part: Row) -> bool:
    """Whether heights are off by more than a prediction can explain."""
    height, le90 = part.get("height_m"), part["predicted_le90_m"]
    return height is not None and le90 is not None and abs(height) > WRONG_LE90 * le90


def told_decoys(rows: list[Row]) -> Row:
    """False registrations and the upper limit of their rate, 95 % one-sided (Clopper and Pearson 1934)."""
    decided = [row for row in rows if row["exit"] in (0, 3)]
    false = [row for row in decided if any(part["status"] == "REGISTERED" for part in row["components"])]
    n, k = len(decided), len(false)
    return {
        "runs": n,
        "failed": len(rows) - n,
        "registered, all falsely": k,
        "upper limit of the rate": float(beta.ppf(0.95, k + 1, n - k)) if n > k else 1.0,
        "false": [f"{row['site']} on {row['reference']}, {row['variant']}" for row in false],
    }


def _key(image: str) -> str:
    """FOLDER/FILE: image names are relative to different roots."""
    return "/".join(PurePosixPath(image).parts[-2:])


if __name__ == "__main__":
    main()
