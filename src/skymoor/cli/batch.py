# SPDX-License-Identifier: Apache-2.0
"""What `skymoor batch` does."""

from __future__ import annotations

from skymoor.cli.batch_arguments import Batch
from skymoor.cli.interrupt import AT_STOP
from skymoor.cli.progress import Screen


def batch(command: Batch) -> int:
    """`skymoor batch`; returns the exit status, the worst of the sites."""
    from skymoor.batch.cluster import run_on_cluster
    from skymoor.batch.local import run_here
    from skymoor.batch.page import write_state
    from skymoor.batch.remote import path_or_address
    from skymoor.batch.sites import exit_status_of, find_sites
    from skymoor.batch.work import pass_on
    from skymoor.cli.tables import outcomes_table
    from skymoor.errors import InputError
    from skymoor.pipeline.stopping import StoppedAfter

    if command.workers < 1:
        raise InputError(f"--workers {command.workers}: give at least 1")
    out = path_or_address(command.out)
    tasks = find_sites(command.sites, out, command.only, command.stop_after)
    arguments = ["--seed", str(command.seed), *(word for one in command.set for word in ("--set", one))]
    AT_STOP.append(pass_on)
    with Screen(plain=command.quiet, for_scripts=command.json, verbose=command.verbose) as screen:
        page, outcomes, track = write_state(out, tasks, []), [], screen.track("sites")
        track(0, len(tasks))
        if command.scheduler:
            ended = run_on_cluster(command.scheduler, tasks, arguments, memory_gb=command.memory)
        else:
            ended = run_here(tasks, arguments, workers=command.workers, memory_gb=command.memory)
        for outcome in ended:
            outcomes.append(outcome)
            write_state(out, tasks, outcomes)
            screen.note(f"{outcome.name}: {outcome.verdict}{'; ' if outcome.message else ''}{outcome.message}")
            track(len(outcomes), len(tasks), outcome.name)
        screen.show(outcomes_table(outcomes))
        if command.stop_after:
            screen.note(str(StoppedAfter(command.stop_after)))
        screen.note(f"results in {out}; to read: {page}")
        screen.answer({"sites": outcomes})
    return exit_status_of(outcomes)
