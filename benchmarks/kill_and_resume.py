# SPDX-License-Identifier: Apache-2.0
"""Kills a run in every one of its stages, starts it again each time, and compares it with one that was left alone.

    python benchmarks/kill_and_resume.py SITE.toml WORK [--seed 0] [--json RESULT.json] [--set NAME=VALUE ...]
    python benchmarks/kill_and_resume.py SITE.toml WORK --kills 100 [--minutes 15] ...

WORK/whole is the undisturbed run, WORK/killed the other. Kills come by SIGKILL at a random moment of each stage, and
twice while products are written; with --kills so many come at random moments of whole runs, and each run that came to
its end in between is compared and begun anew. Every file of the results must be the same, byte for byte, but for the
date, the seconds and the memory in summary.json, and what report.html shows of them.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

PROGRAM = "import sys; from skymoor.cli.main import main; sys.exit(main())"
FINISHED = (0, 3)
ATTEMPTS = 2  # kills of one stage
OF_COSTS = re.compile(
    rb'<table class="stages">.*?</table>|(Date of the run|Processing time).*?</tr>|[0-9.]+ [kM]B', re.DOTALL
)
"""What a report says of when, how long, and the sizes of files, such as the log."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("site", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--kills", type=int, default=0, help="so many at any moment, in place of some in each stage")
    parser.add_argument("--minutes", type=float, default=15.0, help="after which no further kill begins")
    parser.add_argument("--set", action="append", default=[], help="an option of the runs")
    asked = parser.parse_args()
    command = [sys.executable, "-c", PROGRAM, "run", str(asked.site), "--quiet"]
    command += [word for option in asked.set for word in ("--set", option)]
    whole, killed = asked.work / "whole", asked.work / "killed"
    for out in (whole, killed):
        if (out / "stages").exists():
            sys.exit(f"{out}: holds a run already; delete it")
    seconds = finish(command, whole)
    again = finish(command, whole)  # all from the cache: what starting and writing products takes
    stages = json.loads((whole / "summary.json").read_text())["stages"]
    rng = random.Random(asked.seed)
    rounds: list[list[str]] = []
    if asked.kills:
        end = time.monotonic() + 60 * asked.minutes
        kills, rounds = kill_anywhere(command, (whole, killed), stages, again, rng, asked.kills, end)
    else:
        kills = kill_in_every_stage(command, killed, stages, again, rng)
    resumed = finish(command, killed)
    differing = sorted({*compare(whole, killed), *(name for names in rounds for name in names)})
    result = {
        "seconds_whole": round(seconds, 1),
        "seconds_from_cache": round(again, 1),
        "seconds_last_resume": round(resumed, 1),
        "runs_compared": 1 + len(rounds),
        "n_kills": len(kills),
        "kills": kills,
        "stages_hit": sorted({kill["during"] for kill in kills}),
        "files_compared": len(contents(whole)),
        "files_differing": differing,
    }
    print(json.dumps(result, indent=1))
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")
    sys.exit(bool(differing))


def start(command: list[str], out: Path) -> subprocess.Popen[bytes]:
    temporary = out.parent / "temporary"  # where kills leave COLMAP's files
    temporary.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "TMPDIR": str(temporary)}
    return subprocess.Popen(
        [*command, "--out", str(out)], env=environment, stdout=subprocess.DEVNULL, start_new_session=True
    )


def finish(command: list[str], out: Path) -> float:
    """Seconds of a run that is left alone."""
    begin = time.perf_counter()
    status = start(command, out).wait()
    if status not in FINISHED:
        sys.exit(f"{out}: the run ended with status {status}")
    return time.perf_counter() - begin


def kill_in_every_stage(
    command: list[str], out: Path, stages: list[dict[str, Any]], start_s: float, rng: random.Random
) -> list[dict[str, Any]]:
    """Kill while each stage is the first that is not done, at a random moment of it; then twice among the products."""
    kills: list[dict[str, Any]] = []
    for k, stage in enumerate(stages):
        for later in stages[k:]:  # what a former attempt has got done too much
            for file in (out / "stages").glob(f"{later['name']}-*.npz"):
                file.unlink()
        for _ in range(ATTEMPTS):
            # To the stage it takes about as long as to start, without the products at the end.
            patience = rng.uniform(0.5, 1.0) * start_s + rng.uniform(0, stage["seconds"])
            kills += killed_after(command, out, stages, patience)
            if not kills or kills[-1]["during"] != stage["name"]:
                break
        while not done(out, stage["name"]):
            kills += killed_after(command, out, stages, start_s + 3 * stage["seconds"])
    for _ in range(2):
        kills += killed_after(command, out, stages, rng.uniform(0.6, 1.0) * start_s)
    return kills


def kill_anywhere(
    command: list[str],
    folders: tuple[Path, Path],
    stages: list[dict[str, Any]],
    start_s: float,
    rng: random.Random,
    count: int,
    end: float,
) -> tuple[list[dict[str, Any]], list[list[str]]]:
    """Kills at any moment of whole runs; and for each run that came to its end, which of its files differ."""
    whole, out = folders
    kills: list[dict[str, Any]] = []
    rounds: list[list[str]] = []
    work_s = sum(stage["seconds"] for stage in stages)
    while len(kills) < count and time.monotonic() < end:
        # Mostly soon, for many kills of one run; now and then late enough for the longest stage.
        after = rng.expovariate(10 / work_s) if rng.random() < 0.6 else rng.uniform(0, 0.7 * work_s)
        patience = rng.uniform(0.1, 0.5) * start_s + after
        found = killed_after(command, out, stages, patience)
        kills += found
        if not found:
            rounds.append(compare(whole, out))
            print(f"run {len(rounds)} is whole after {len(kills)} kills; differing: {rounds[-1]}", flush=True)
            work_s = sum(stage["seconds"] for stage in json.loads((out / "summary.json").read_text())["stages"])
            shutil.rmtree(out)
    return kills, rounds


def killed_after(command: list[str], out: Path, stages: list[dict[str, Any]], patience: float) -> list[dict[str, Any]]:
    """What was killed, none if the run ended before."""
    process = start(command, out)
    try:
        status = process.wait(patience)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        during = next((stage["name"] for stage in stages if not done(out, stage["name"])), "products")
        print(f"killed after {patience:.1f} s in {during}", flush=True)
        return [{"after_s": round(patience, 2), "during": during}]
    if status not in FINISHED:
        sys.exit(f"{out}: the run ended with status {status}")
    return []


def done(out: Path, stage: str) -> bool:
    return any((out / "stages").glob(f"{stage}-" + "[0-9a-f]" * 12 + ".npz"))


def contents(out: Path) -> dict[str, object]:
    """All products by their name; the summary without what a stage cost."""
    found: dict[str, object] = {}
    for path in out.rglob("*"):
        name = path.relative_to(out).as_posix()
        if path.is_file() and not name.startswith(("stages/", ".lock", "run.log")):
            found[name] = path.read_bytes()
    summary = json.loads((out / "summary.json").read_text())
    found["summary.json"] = {
        **{key: value for key, value in summary.items() if key not in ("date", "seconds")},
        "stages": [(stage["name"], stage["key"]) for stage in summary["stages"]],
    }
    found["report.html"] = OF_COSTS.sub(b"", (out / "report.html").read_bytes())
    return found


def compare(whole: Path, killed: Path) -> list[str]:
    """Names of the products that differ."""
    a, b = contents(whole), contents(killed)
    leftovers = [f"{path.relative_to(killed)} (left over)" for path in killed.rglob(".skymoor-*")]
    return sorted(name for name in {*a, *b} if a.get(name) != b.get(name)) + leftovers


if __name__ == "__main__":
    main()
