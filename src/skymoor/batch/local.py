# SPDX-License-Identifier: Apache-2.0
"""Sites on this machine, several at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from skymoor.batch.sites import Outcome, SiteTask
from skymoor.batch.work import run_site


def run_here(
    tasks: Sequence[SiteTask], arguments: Sequence[str], *, workers: int, memory_gb: float | None
) -> Iterator[Outcome]:
    """The outcomes of all sites as they end, `workers` at a time, which share the processors."""
    threads = max(1, (os.cpu_count() or 1) // workers)
    # Each thread only waits for the process of its site.
    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(run_site, task, arguments, memory_gb, threads) for task in tasks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
