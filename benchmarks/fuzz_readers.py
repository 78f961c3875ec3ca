# SPDX-License-Identifier: Apache-2.0
"""Gives every reader of outside files damaged ones: each must be read, or refused with one line that names it.

    python benchmarks/fuzz_readers.py WORK [--minutes 25] [--seed 0] [--run RUN] [--only NAME ...] [--json FILE]
    python benchmarks/fuzz_readers.py WORK --again             # what was found before, with the sources as they are now
    python benchmarks/fuzz_readers.py WORK --case NAME/NUMBER  # one case, with its traceback

The seeds are written to WORK/seeds; RUN is a finished run of a small site, such as that of skymoor demo, without
which the readers of runs are left out. Case NUMBER of a reader depends on the seed and NUMBER alone; the same command
goes on where it stopped. Cases are read in a child process with little memory beyond what it has after its imports,
which is started again after a crash, or a case of more than a minute. What is neither read nor refused is a finding:
its files are kept in WORK/findings.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from fuzz_mutations import damage
from fuzz_seeds import write_seeds

LIMIT_S = 20.0
MEMORY_BYTES = 3 * 2**30
LARGEST_KEPT = 50_000_000  # bytes
AT_ONCE = 400  # cases of one child: what leaks does not count for long
WHOLE = -1  # the number of the case in which nothing is damaged
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("work", type=Path)
    parser.add_argument("--minutes", type=float, default=25.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--run", type=Path, help="a finished run")
    parser.add_argument("--only", nargs="*", default=[], help="readers")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--case")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    work = asked.work.resolve()
    if asked.child:
        child(work, asked.seed)
    elif asked.case:
        reader, _, number = asked.case.partition("/")
        print(json.dumps(outcome_of(work, asked.seed, reader, int(number), shown=True), indent=1))
    else:
        write_seeds(work / "seeds", asked.run)
        log = Log(work / "cases.jsonl")
        fuzz(work, asked.seed, log, asked.minutes, asked.only, again=asked.again)
        report = log.report()
        print(json.dumps(report, indent=1))
        if asked.json:
            asked.json.write_text(json.dumps({"seed": asked.seed, **report}, indent=1) + "\n")


class Log:
    """All cases that were tried; the last outcome of a case counts, and the first one that was a finding is known."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.first: dict[tuple[str, int], dict[str, Any]] = {}
        self.last: dict[tuple[str, int], dict[str, Any]] = {}
        if path.exists():
            for line in path.read_text().splitlines():
                self._add(json.loads(line))

    def _add(self, entry: dict[str, Any]) -> None:
        key = entry["reader"], entry["case"]
        self.first.setdefault(key, entry)
        self.last[key] = entry

    def write(self, entry: dict[str, Any]) -> None:
        self._add(entry)
        with self._path.open("a") as file:
            file.write(json.dumps(entry) + "\n")

    def report(self) -> dict[str, Any]:
        """Counts of each reader, and the kinds of findings that are left."""
        readers: dict[str, Counter[str]] = {}
        left: dict[str, list[str]] = {}
        for (reader, case), entry in self.last.items():
            counts = readers.setdefault(
                reader, Counter(cases=0, read=0, refused=0, findings_before=0, findings_after=0)
            )
            counts["cases"] += 1
            counts["findings_before"] += self.first[reader, case]["outcome"] == "finding"
            counts["findings_after" if entry["outcome"] == "finding" else entry["outcome"]] += 1
            if entry["outcome"] == "finding":
                left.setdefault(f"{entry['kind']} in {entry['where']}", []).append(f"{reader}/{case}")
        total = Counter[str]()
        for counts in readers.values():
            total.update(counts)
        seconds = sum(entry["seconds"] for entry in self.last.values())
        shown = {kind: [len(cases), *cases[:3]] for kind, cases in sorted(left.items())}
        return {"total": total, "seconds": round(seconds), "readers": readers, "left": shown}


def fuzz(work: Path, seed: int, log: Log, minutes: float, only: list[str], *, again: bool) -> None:
    """Cases of all readers, with the same time for each, until it is over; or all former findings once more."""
    from fuzz_targets import TARGETS

    names = [name for name, target in TARGETS.items() if (work / "seeds" / target.seed).is_dir()]
    names = [name for name in names if not only or name in only]
    todo = [key for key, entry in log.first.items() if entry["outcome"] == "finding" and key[0] in names]
    following = {name: 1 + max((case for reader, case in log.first if reader == name), default=-1) for name in names}
    spent = Counter[str](dict.fromkeys(names, 0))
    for (reader, _), entry in log.first.items():
        spent[reader] += entry["seconds"]
    worker = Worker(work, seed)
    whole = {name: worker.outcome(name, WHOLE) for name in names}
    if any(entry["outcome"] != "read" for entry in whole.values()):
        sys.exit(f"seeds that are not read: {[entry for entry in whole.values() if entry['outcome'] != 'read']}")
    end = time.monotonic() + 60 * minutes
    while todo if again else time.monotonic() < end:
        if again:
            reader, case = todo.pop(0)
            log.write(worker.outcome(reader, case))
            continue
        reader = min(names, key=lambda name: spent[name])
        entry = worker.outcome(reader, following[reader])
        log.write(entry)
        spent[reader] += entry["seconds"]
        following[reader] += 1
    worker.stop()


class Worker:
    """A child that reads cases; a new one after each that did not survive."""

    def __init__(self, work: Path, seed: int) -> None:
        self._command = [sys.executable, __file__, str(work), "--child", "--seed", str(seed)]
        self._work, self._errors = work, work / "stderr.txt"
        self._process: subprocess.Popen[str] | None = None
        self._left = 0

    def outcome(self, reader: str, case: int) -> dict[str, Any]:
        """A case that takes too long is tried once more, with more time: the machine may have other work."""
        found = self._outcome(reader, case, LIMIT_S)
        return self._outcome(reader, case, 3 * LIMIT_S) if found.get("kind") == "hang" else found

    def _outcome(self, reader: str, case: int, limit_s: float) -> dict[str, Any]:
        if self._process is None or self._left == 0:
            self.stop()
            self._start()
        assert self._process is not None and self._process.stdin is not None and self._process.stdout is not None
        self._left -= 1
        start = time.monotonic()
        self._process.stdin.write(f"{reader} {case}\n")
        self._process.stdin.flush()
        ready = select.select([self._process.stdout], [], [], limit_s)[0]
        line = self._process.stdout.readline() if ready else ""
        entry = {"reader": reader, "case": case, "seconds": round(time.monotonic() - start, 3)}
        if line:
            return entry | json.loads(line)
        self._process.kill()
        status = self._process.wait()
        self._process = None
        trace = self._errors.read_text(errors="replace")[-3000:]
        kind = f"signal {-status}" if ready else "hang"
        keep(self._work, reader, case)
        return entry | {"outcome": "finding", "kind": kind, "where": _frame_of(trace), "trace": trace}

    def _start(self) -> None:
        with self._errors.open("w") as errors:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env={**os.environ, **ONE_THREAD},
            )
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it is there, with all that it imports
        self._left = AT_ONCE

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def _frame_of(trace: str) -> str:
    """The innermost place in skymoor of a traceback of faulthandler."""
    last = trace.rpartition("most recent call first")[2]
    found = [line for line in last.splitlines() if "/skymoor/" in line and "File" in line]
    return found[0].split("/skymoor/")[-1].replace('", line ', ":").split(" in ")[0] if found else "?"


def child(work: Path, seed: int) -> None:
    """Read cases from the standard input, and write what became of each to the standard output."""
    import faulthandler
    import resource

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # libraries print
    faulthandler.enable()
    from fuzz_targets import warm_up

    warm_up()
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        reader, case = line.split()
        faulthandler.dump_traceback_later(LIMIT_S - 1)
        found = outcome_of(work, seed, reader, int(case))
        faulthandler.cancel_dump_traceback_later()
        answers.write(json.dumps(found) + "\n")
        answers.flush()


def outcome_of(work: Path, seed: int, reader: str, case: int, *, shown: bool = False) -> dict[str, Any]:
    """Make a case, and read it: what came of it."""
    from fuzz_targets import TARGETS, examined

    target, rng = TARGETS[reader], random.Random(f"{seed}/{reader}/{case}")
    folder = work / "case" / reader
    shutil.rmtree(folder.parent, ignore_errors=True)
    shutil.copytree(work / "seeds" / target.seed, folder, copy_function=os.link)
    others = sorted(path for path in (work / "seeds").glob("*/*") if path.is_file() and path.stat().st_size < 100_000)
    files = sorted(path for pattern in target.files for path in folder.glob(pattern) if path.is_file())
    chosen = [] if case == WHOLE else list(dict.fromkeys(rng.choices(files, k=rng.choice((1, 1, 1, 1, 2)))))
    done = {path.relative_to(folder).as_posix(): damage(path, rng, others) for path in chosen}
    found = examined(target, folder, chosen, shown=shown)
    if found["outcome"] == "finding":
        keep(work, reader, case)
    return {"damage": done, **found}


def keep(work: Path, reader: str, case: int) -> None:
    """The damaged files of a case; all others have a second link, in the seed."""
    for path in (work / "case" / reader).rglob("*"):
        if path.is_file() and path.stat().st_nlink == 1 and path.stat().st_size < LARGEST_KEPT:
            kept = work / "findings" / f"{reader}-{case}"
            kept.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, kept / path.name)


if __name__ == "__main__":
    main()
