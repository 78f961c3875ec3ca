# SPDX-License-Identifier: Apache-2.0
"""Ground photos under real conditions: what is placed, how well, and what is placed that belongs nowhere.

    python benchmarks/ground_sites.py --out RUNS [--cases 12] [--decoys mirrored] [--results FILE]

Each case is a site simulated under real conditions with two folders of ground photos, run and evaluated by the skymoor
commands. Decoys are its ground components mirrored, on its own airborne model (`mirrored`), or on that of the next case
of another preset (`elsewhere`): every placement of one is wrong. Everything resumes: start it in the background, look
at the logs, start it again.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from paper_tables import provenance, skymoor, split

from skymoor.geometry import Similarity
from skymoor.ground.walls import AirborneWalls, search_ground
from skymoor.store import read_stage
from skymoor.types import DepthMap

# Preset, seed, flight, tilt of a grid.
CASES = [
    ("office-park", 21, "grid", 12),
    ("industrial", 22, "grid", 20),
    ("hillside", 23, "orbits", 15),
    ("office-park", 24, "orbits", 15),
    ("industrial", 25, "orbits", 15),
    ("hillside", 26, "grid", 8),
    ("office-park", 27, "grid", 20),
    ("industrial", 28, "grid", 10),
    ("hillside", 29, "grid", 18),
    ("office-park", 30, "orbits", 15),
    ("industrial", 31, "orbits", 15),
    ("hillside", 32, "orbits", 15),
]
SITE = "--conditions real --radius-m 55 --airborne 24 --groups 2 --group-photos 32 --security 0 --photo-width 1000"
SITE += " --samples 1 --reference-width-m 220"
# The airborne place is not what is judged here: about the flying height of the simulated flights.
RUN = "--set match.min_height_m=50 --set match.max_height_m=120"
WRONG_M = 3.0  # own error beyond which a placement is wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=len(CASES), help="the first ones")
    parser.add_argument("--decoys", nargs="*", choices=("mirrored", "elsewhere"), default=["mirrored"])
    parser.add_argument("--results", type=Path, help="a JSON file for the rows, with machine, date and commit")
    options = parser.parse_args()
    cases = CASES[: options.cases]
    rows = [row for case in cases for row in placed(folder_of(options.out, case), case)]
    for kind in options.decoys:
        rows += [row for case in cases for row in decoys(options.out, case, cases, kind)]
    show(rows)
    if options.results:
        options.results.write_text(json.dumps({**provenance(1000), "rows": rows}, indent=1) + "\n")


def folder_of(out: Path, case: tuple[Any, ...]) -> Path:
    return out / f"{case[0]}-{case[1]}-{case[2]}"


def placed(folder: Path, case: tuple[Any, ...]) -> list[dict[str, Any]]:
    """One row for each ground component of a case, from its run."""
    preset, seed, flight, tilt = map(str, case)
    folder.mkdir(parents=True, exist_ok=True)
    site, result = folder / "site", folder / "result"
    chosen = ("--preset", preset, "--seed", seed, "--flight", flight, "--tilt-deg", tilt, *SITE.split())
    with (folder / "log.txt").open("a") as log:
        made = (site / "site.toml").exists() or skymoor(log, "simulate", *chosen, "--out", str(site)) == 0
        status = skymoor(log, "run", str(site / "site.toml"), "--out", str(result), *RUN.split()) if made else 2
        if status not in (0, 3) or skymoor(log, "evaluate", str(result), "--truth", str(site / "truth.csv")):
            print(f"{folder.name}: exit {status}, see {folder / 'log.txt'}", flush=True)
            return []
    truth = json.loads((site / "truth.json").read_text())
    photos = sum(len(list(one.glob("*.jpg"))) for one in site.glob("ground_*"))
    rows = []
    for found in json.loads((result / "evaluation.json").read_text())["rows"]:
        if found["set"] == "airborne":
            continue
        own = split(site, result, found, truth)
        error = own.get("own_mean_absolute_m")
        rows.append(
            {
                "case": folder.name,
                "flight": flight,
                "component": f"{found['set']}-{found['component']}",
                "photos": found["n_cameras"],
                "photos_of_site": photos,
                "placed": found["status"] == "REGISTERED",
                "wrong": error is not None and error > WRONG_M,
                **own,
                "predicted_ce90_m": found.get("predicted_relative_ce90_m"),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def decoys(out: Path, case: tuple[Any, ...], cases: Sequence[tuple[Any, ...]], kind: str) -> list[dict[str, Any]]:
    """One row for each component of a case, searched where it does not belong."""
    run = folder_of(out, case) / "result"
    others = [other for other in cases if other[0] != case[0]]
    target = run if kind == "mirrored" else folder_of(out, others[int(case[1]) % len(others)]) / "result"
    walls = stage(target, "walls")
    names = sorted({re.split(r"\.depths", path.name)[0] for path in (run / "stages").glob("ground*.depths-*")})
    rows = []
    for name in names if walls is not None else []:
        file = run / f"decoy-{kind}-{name}.json"
        if not file.exists():
            maps = stage(run, f"{name}.depths")
            file.write_text(json.dumps({"case": run.parent.name, **decoy(maps, walls, kind, name)}))
        rows.append(json.loads(file.read_text()))
        print(json.dumps(rows[-1]), flush=True)
    return rows


def decoy(maps: Sequence[DepthMap], walls: AirborneWalls, kind: str, name: str) -> dict[str, Any]:
    started = time.process_time()
    searched = [mirrored(one) for one in maps] if kind == "mirrored" else maps
    found = search_ground(searched, walls, rng=np.random.default_rng(0)).decide()
    names = ("likelihood", "second_likelihood", "plan_score", "cells", "contrast")
    told = {one: found.diagnostics.get(one) for one in names}
    seconds = round(time.process_time() - started, 1)
    return {"component": name, "decoy": kind, "photos": len(maps), "placed": found.registered, **told, "cpu_s": seconds}


def mirrored(one: DepthMap) -> DepthMap:
    """The depth map of a mirror image of the world: as plausible, and found nowhere."""
    camera, flip = one.camera, np.diag([-1.0, 1.0, 1.0])
    pose = camera.cam_from_world
    turned = Similarity(pose.scale, flip @ pose.rotation @ flip, flip @ pose.translation)
    lens = replace(camera.intrinsics, cx=camera.intrinsics.width - camera.intrinsics.cx)
    layers = {name: np.ascontiguousarray(getattr(one, name)[:, ::-1]) for name in ("depth", "sigma", "n_views", "rgb")}
    return replace(one, camera=replace(camera, intrinsics=lens, cam_from_world=turned), **layers)


def stage(run: Path, name: str) -> Any:
    """The kept result of a stage; None where there is none."""
    try:
        return read_stage(run, name)
    except FileNotFoundError:
        return None


def show(rows: Sequence[dict[str, Any]]) -> None:
    """Markdown: a row for each kind of flight and one for the decoys."""
    real, fakes = ([row for row in rows if ("decoy" in row) == fake] for fake in (False, True))
    print("\n| flight | components placed | photos placed | wrong | own error m | within CE90 |\n|" + "---|" * 6)
    for flight in ("grid", "orbits"):
        own = [row for row in real if row["flight"] == flight]
        done = [row for row in own if row["placed"]]
        total = sum({row["case"]: row["photos_of_site"] for row in own}.values())
        errors = sorted(row["own_mean_absolute_m"] for row in done)
        inside = sum(row["own_horizontal_m"] <= row["predicted_ce90_m"] for row in done if row["predicted_ce90_m"])
        counts = f"{len(done)} of {len(own)} | {sum(row['photos'] for row in done)} of {total}"
        spread = f"{errors[0]:.2f} to {errors[-1]:.2f}" if errors else "-"
        print(f"| {flight} | {counts} | {sum(row['wrong'] for row in done)} | {spread} | {inside} of {len(done)} |")
    likelihoods = np.array([row["likelihood"] for row in fakes if row["likelihood"] is not None])
    wrong = sum(row["placed"] for row in fakes)
    print(f"\ndecoys placed: {wrong} of {len(fakes)}", end="")
    if len(likelihoods) > 1:
        print(f"; their likelihood: mean {likelihoods.mean():.2f}, standard deviation {likelihoods.std(ddof=1):.2f}")


if __name__ == "__main__":
    main()
