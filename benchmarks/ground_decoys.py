# SPDX-License-Identifier: Apache-2.0
"""Ground components registered to the right airborne model, and to models of other sites, where nothing is right.

    python benchmarks/ground_decoys.py RUN RUN [...] --answers FOLDER [--others 2] [--results FILE]

Each RUN is the folder of a case of `paper_tables.py`: a simulated site and its finished run, whose depth maps and walls
are used. An answer is right if it puts the component's cameras within `RIGHT_M` of where they are (median). The table
has, for right and for wrong answers, what the decision rests on. Hypotheses are kept in FOLDER, and those there are not
computed again: start it in the background, and again after a stop.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from paper_tables import provenance

from skymoor.geo import EnuFrame
from skymoor.ground.walls import AirborneWalls, WallHypotheses, search_ground
from skymoor.results.tables import read_truth_csv
from skymoor.store import read_stage
from skymoor.store._cache import read_cache, write_cache
from skymoor.types import DepthMap

RIGHT_M = 3.0
COMPONENTS = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--answers", type=Path, required=True)
    parser.add_argument("--others", type=int, default=2, help="airborne models of other places, per component")
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    options.answers.mkdir(parents=True, exist_ok=True)
    walls = {run: stage(run, "walls") for run in options.runs}
    rows = []
    for run, k, maps in components(options.runs):
        # Not another seed of the same preset: its buildings are of the same kind.
        others = [other for other in options.runs if kind(other) != kind(run)]
        chosen = [others[(k + 2 * i) % len(others)] for i in range(min(options.others, len(others)))]
        for other in [run, *chosen]:
            answers, seconds = searched(options.answers / f"{run.name}-{k}-on-{other.name}.npz", maps, walls[other])
            rows.append(row(run, k, maps, other, answers, seconds))
            print(json.dumps(rows[-1]), flush=True)
    show(rows)
    if options.results:
        options.results.write_text(json.dumps({**provenance(640), "rows": rows}, indent=1) + "\n")


def kind(run: Path) -> str:
    """The preset of a run by its folder's name."""
    return run.name.rpartition("-")[0]


def stage(run: Path, name: str) -> Any:
    """The kept result of a stage; None where there is none."""
    try:
        return read_stage(run / "result", name)
    except FileNotFoundError:
        return None


def components(runs: list[Path]) -> list[tuple[Path, int, list[DepthMap]]]:
    """All ground components that have depth."""
    found = [(run, k, stage(run, f"ground0-{k}.depths")) for run in runs for k in range(COMPONENTS)]
    return [(run, k, maps) for run, k, maps in found if maps]


def searched(file: Path, maps: list[DepthMap], walls: AirborneWalls) -> tuple[WallHypotheses, float]:
    """The answers, from the file if it is there, and what they cost."""
    if not file.exists():
        started = time.process_time()
        answers = search_ground(maps, walls, rng=np.random.default_rng(0))
        write_cache(file, time.process_time() - started, answers)
    seconds, found = read_cache(file)
    return found, seconds


def row(
    run: Path, k: int, maps: list[DepthMap], other: Path, answers: WallHypotheses, seconds: float
) -> dict[str, Any]:
    """One component on one airborne model: the decision, and each answer with how far off it is."""
    found = answers.decide()
    off = [None] * len(answers.similarities) if other != run else offsets_m(run, maps, answers)
    contrasts = [round(candidate.contrast, 2) for candidate in answers.candidates]
    wrong = [c for c, m in zip(contrasts, off, strict=True) if m is None or m > RIGHT_M]
    right = [c for c, m in zip(contrasts, off, strict=True) if m is not None and m <= RIGHT_M]
    told = {name: round(value, 2) for name, value in found.diagnostics.items() if "contrast" in name or "score" in name}
    return {
        "site": run.name,
        "component": k,
        "photos": len(maps),
        "on": other.name,
        "registered": found.registered,
        "wrong": found.registered and (not contrasts or off[0] is None or off[0] > RIGHT_M),
        "reason": found.reason,
        "off_m": off[0] if off else None,
        "best_right": max(right, default=None),
        "best_wrong": max(wrong, default=None),
        "answers": len(contrasts),
        "seconds": round(seconds, 1),
        **told,
    }


def offsets_m(run: Path, maps: list[DepthMap], answers: WallHypotheses) -> list[float | None]:
    """Median distance of the cameras from the truth, without the reference's bias, of each answer."""
    truth = json.loads((run / "site/truth.json").read_text())
    origin = json.loads((run / "result/summary.json").read_text())["enu_origin"]
    frame = EnuFrame(origin["lat"], origin["lon"], origin["height"])
    true = {t.image: frame.enu_from_lla(t.lat, t.lon, t.height).ravel() for t in read_truth_csv(run / "site/truth.csv")}
    wanted = np.array([true[m.camera.image] for m in maps]) + np.array(truth["bias_m"])
    centres = np.array([m.camera.centre for m in maps])
    return [round(float(np.median(np.linalg.norm(p.apply(centres) - wanted, axis=1))), 2) for p in answers.similarities]


def show(rows: list[dict[str, Any]]) -> None:
    """Markdown."""
    print("\n| component | on | status | off m | contrast, next | best right, best wrong | s |\n|" + "---|" * 7)
    for r in rows:
        status = ("WRONG" if r["wrong"] else "REGISTERED") if r["registered"] else "refused"
        contrast = f"{r.get('contrast', 0):.1f}, {r.get('second_contrast', 0):.1f}"
        best = f"{r['best_right'] or '-'}, {r['best_wrong'] or '-'}"
        name = f"{r['site']} {r['component']}"
        print(f"| {name} | {r['on']} | {status} | {r['off_m'] or '-'} | {contrast} | {best} | {r['seconds']:.0f} |")
    own, decoys = ([r for r in rows if (r["on"] == r["site"]) == mine] for mine in (True, False))
    placed = sum(r["registered"] and not r["wrong"] for r in own)
    print(f"\n{placed} of {len(own)} on their own site, {sum(r['wrong'] for r in own)} wrongly; ", end="")
    print(f"{sum(r['registered'] for r in decoys)} of {len(decoys)} on other sites")


if __name__ == "__main__":
    main()
