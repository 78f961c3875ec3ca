# SPDX-License-Identifier: Apache-2.0
"""Sites on the workers of a Dask cluster that somebody else has started."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from typing import Any

from skymoor.batch.remote import Address
from skymoor.batch.sites import FAILED, Outcome, SiteTask
from skymoor.batch.work import run_site
from skymoor.engines.libraries import require
from skymoor.errors import InputError, SkymoorError

CONNECT_S = 15
RETRIES = 3  # of a site whose worker is lost


class ClusterLost(SkymoorError):
    """The scheduler went away; what has ended is kept."""


def run_on_cluster(
    address: str, tasks: Sequence[SiteTask], arguments: Sequence[str], *, memory_gb: float | None
) -> Iterator[Outcome]:
    """The outcomes of all sites as they end. A site whose worker is lost is run again on another, where it goes on.

    Args:
        address: of the scheduler, such as tcp://10.0.0.1:8786.
        tasks: the sites; they and their folders must be seen by all workers under the same paths or addresses.
        arguments, memory_gb: as in `run_site`.

    Raises:
        BackendUnavailable: Dask is not installed.
        InputError: no scheduler answers, or workers do not see the folders.
        ClusterLost: it no longer does.
    """
    for task in tasks:
        if isinstance(task.out, Address) and task.out.in_memory:
            raise InputError(f"{task.out}: workers do not see the memory of this process; give a store that all see")
    distributed = require("distributed", "dask")
    try:
        client = distributed.Client(address, timeout=CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers ({error}); start one with dask scheduler, and workers "
            "with dask worker"
        ) from error
    with client:
        more = {"pure": False, "retries": RETRIES}
        task_of = {client.submit(run_site, task, tuple(arguments), memory_gb, **more): task for task in tasks}
        ended = 0
        try:
            for future in distributed.as_completed(task_of):
                yield _outcome(future, task_of[future])
                ended += 1
        except (CancelledError, OSError) as error:
            told = f"{ended} of {len(tasks)} sites had ended; the same command goes on from there"
            raise ClusterLost(f"--scheduler {address}: was lost when {told}") from error


def _outcome(future: Any, task: SiteTask) -> Outcome:
    """What a worker returned; a site whose workers are lost again and again has failed, and only it."""
    if future.status == "cancelled":
        raise CancelledError
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    return Outcome(task.name, task.out, FAILED, 0.0, message=f"its workers were lost: {future.exception()}")
