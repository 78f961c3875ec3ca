# SPDX-License-Identifier: Apache-2.0
"""What the commands about the machine and the program itself do."""

from __future__ import annotations

import json
from dataclasses import asdict

from skymoor.cli.arguments import Bench
from skymoor.cli.machine_arguments import Doctor, Grids, GridsFetch, Schema, Weights, WeightsFetch
from skymoor.cli.progress import Screen


def weights(command: Weights) -> None:
    """`skymoor weights list` and `skymoor weights fetch`."""
    from skymoor.cli.tables import weights_table
    from skymoor.engines.weights import KNOWN, fetch, weights_folder

    if not isinstance(command.action, WeightsFetch):
        folder = weights_folder()
        with Screen(plain=True, for_scripts=command.action.json) as screen:
            screen.show(weights_table(KNOWN, folder))
            screen.answer({"folder": folder, "weights": KNOWN})
        return
    wanted = command.action
    with Screen(plain=wanted.quiet, verbose=wanted.verbose) as screen:
        for file in fetch(wanted.name, wanted.to or weights_folder(), lambda name: screen.track(f"{name}, MB")):
            digest = "" if file.sha256 is None else f", sha256 {file.sha256}"
            screen.note(f"{file.path}: {'was here' if file.was_there else 'fetched'}{digest}")
        if wanted.to is not None and wanted.to != weights_folder():
            screen.note(f"engines find it there if SKYMOOR_WEIGHTS={wanted.to}")


def grids(command: Grids) -> None:
    """`skymoor grids list` and `skymoor grids fetch`."""
    from skymoor.cli.tables import grids_table
    from skymoor.engines.proj_grids import COMMON, fetch_grid, grids_of, user_folder

    if not isinstance(command.action, GridsFetch):
        with Screen(plain=True, for_scripts=command.action.json) as screen:
            known = [grids_of(code) for code in COMMON]
            screen.show(grids_table(known, user_folder()))
            screen.answer({"folder": user_folder(), "datums": known})
        return
    with Screen(plain=command.action.quiet, verbose=command.action.verbose) as screen:
        file = fetch_grid(command.action.name, lambda name: screen.track(f"{name}, MB"))
        digest = "" if file.sha256 is None else f", sha256 {file.sha256}"
        screen.note(f"{file.path}: {'was here' if file.was_there else 'fetched'}{digest}")


def doctor(command: Doctor) -> bool:
    """`skymoor doctor`; returns whether nothing that is needed is missing."""
    from skymoor.cli.doctor import examine
    from skymoor.cli.tables import checks_table

    checks = examine(command.out)
    with Screen(plain=True, for_scripts=command.json) as screen:
        screen.show(checks_table(checks))
        missing = [check.name for check in checks if check.status == "missing"]
        screen.note(f"missing: {', '.join(missing)}" if missing else "all that runs need is here")
        screen.answer({"checks": [{**asdict(check), "status": check.status} for check in checks]})
    return all(check.status != "missing" for check in checks)


def bench(command: Bench) -> None:
    """`skymoor bench srif`."""
    from skymoor.bench import LEFT_OUT, bench_record, by_kind, code_of, find_pairs, measure, search_and_match
    from skymoor.cli.tables import bench_table
    from skymoor.store import atomic_file, plain

    with Screen(plain=command.quiet, for_scripts=command.json, verbose=command.verbose) as screen:
        pairs = find_pairs(command.folder, screen.track("read the pairs"))
        for kind, reason in LEFT_OUT.items():
            screen.note(f"{kind} is left out: {reason}")
        command.out.mkdir(parents=True, exist_ok=True)
        log = command.out / f"{command.dataset}.jsonl"
        rows = measure(search_and_match, "skymoor", pairs, log, code_of(), screen.track("pairs"))
        record, file = plain(bench_record(rows)), command.out / f"{command.dataset}.json"
        with atomic_file(file) as out:
            out.write((json.dumps(record, indent=1) + "\n").encode())
        screen.show(bench_table(by_kind(rows)))
        screen.note(f"{file}: all pairs, with version and machine")
        screen.answer(record)


def schema(_: Schema) -> None:
    """`skymoor schema`."""
    from skymoor.pipeline.site_schema import site_schema

    with Screen(plain=True, for_scripts=True) as screen:
        screen.answer(site_schema(), indent=2)
