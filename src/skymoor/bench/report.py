# SPDX-License-Identifier: Apache-2.0
"""Tables and the record of measurements on pairs of images."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from skymoor import __version__
from skymoor.bench.measure import Row
from skymoor.bench.method import search_and_match
from skymoor.bench.srif import LEFT_OUT
from skymoor.store import defining_modules, fingerprint

WITHIN_PX = (3.0, 5.0, 10.0)
ALL = "all"


@dataclass(frozen=True)
class KindRow:
    """One method on all pairs of one kind, or on all.

    `mean_error_px` and `median_error_px` count a pair without an answer as its second image's diagonal, and no error as
    more than that. `within` are the numbers of pairs within 3, 5 and 10 pixels; `cpu_s` is the mean per pair.
    """

    method: str
    kind: str
    pairs: int
    answers: int
    within: tuple[int, ...]
    mean_error_px: float
    median_error_px: float
    cpu_s: float


def by_kind(rows: Sequence[Row]) -> list[KindRow]:
    """One row for each method and kind, in the order of the rows, and one of each method for all kinds."""
    found = []
    for method in dict.fromkeys(row.method for row in rows):
        own = [row for row in rows if row.method == method]
        kinds = list(dict.fromkeys(row.kind for row in own))
        found += [_summed(method, kind, [row for row in own if row.kind == kind]) for kind in kinds]
        found += [_summed(method, ALL, own)] if len(kinds) > 1 else []
    return found


def code_of(method: Callable[..., object] = search_and_match) -> str:
    """Digest of the source text that a function of this package depends on."""
    return fingerprint(defining_modules(method))[:12]


def bench_record(rows: Sequence[Row]) -> dict[str, Any]:
    """What the JSON file holds: results by kind and by pair, what was left out, and which program and machine."""
    return {
        "dataset": "SRIF",
        "left_out": LEFT_OUT,
        "skymoor": __version__,
        "code": code_of(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine(),
        "kinds": by_kind(rows),
        "pairs": [{name: value for name, value in asdict(row).items() if name != "key"} for row in rows],
    }


def machine() -> dict[str, Any]:
    """Processor, cores and threads, system and Python."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    except OSError:  # not on Linux
        pass
    return {
        "processor": name,
        "cores": os.cpu_count(),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS"),
        "system": platform.platform(),
        "python": platform.python_version(),
    }


def _summed(method: str, kind: str, rows: Sequence[Row]) -> KindRow:
    errors = np.array([row.diagonal_px if row.error_px is None else min(row.error_px, row.diagonal_px) for row in rows])
    within = tuple(sum(row.error_px is not None and row.error_px <= limit for row in rows) for limit in WITHIN_PX)
    return KindRow(
        method,
        kind,
        len(rows),
        sum(row.error_px is not None for row in rows),
        within,
        round(float(errors.mean()), 2),
        round(float(np.median(errors)), 2),
        round(float(np.mean([row.cpu_s for row in rows])), 2),
    )
