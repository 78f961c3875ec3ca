# SPDX-License-Identifier: Apache-2.0
"""Run a method on pairs of images, one line of a log for each, so that an interrupted measurement goes on."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from skymoor.bench.method import Method
from skymoor.bench.srif import Pair, label_error_px
from skymoor.errors import InputError
from skymoor.store import atomic_file, fingerprint
from skymoor.types import Progress, no_progress

BEGINNING = '{"method": '  # how each line begins


@dataclass(frozen=True)
class Row:
    """One method on one pair: error in pixels of the second image, None without an answer, and CPU seconds.

    `diagonal_px` is that of the second image, and `key` tells what was measured: the data and the code.
    """

    method: str
    kind: str
    pair: str
    error_px: float | None
    diagonal_px: float
    cpu_s: float
    inliers: int
    score: float | None
    key: str


def measure(
    method: Method, name: str, pairs: Sequence[Pair], log: Path, code: str, progress: Progress = no_progress
) -> list[Row]:
    """Rows of all pairs, in their order.

    Args:
        method, name: what is measured, and how the log calls it.
        pairs: as found by `find_pairs`.
        log: JSON lines, which may hold rows of other methods; a row that is there is not measured again.
        code: tells versions of the method apart: rows of another one do not count.
        progress: called after each pair.

    Raises:
        InputError: the log is a file of something else.
    """
    known = {row.key: row for row in read_rows(log)}
    found = []
    for done, pair in enumerate(pairs):
        key = key_of(name, code, pair)
        if key not in known:
            known[key] = _measured(method, name, pair, key)
            with log.open("a", encoding="utf-8") as out:
                out.write(json.dumps(asdict(known[key])) + "\n")
        found.append(known[key])
        progress(done + 1, len(pairs))
    return found


def key_of(name: str, code: str, pair: Pair) -> str:
    """Tells what a row measures: the method, its code and that which reads the pair, and the pair's files."""
    return f"{name} {code} {fingerprint([Pair.__module__])[:12]} {pair.content}"


def read_rows(log: Path) -> list[Row]:
    """Rows of a log; a last line that was cut off is removed from the file. Raises `InputError` for another file."""
    if not log.exists():
        return []
    text = log.read_text(encoding="utf-8", errors="replace")
    whole, _, rest = text.rpartition("\n")
    try:
        rows = [Row(**json.loads(line)) for line in whole.splitlines()]
        if not rest.startswith(BEGINNING[: len(rest)]):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(f"{log}: is no log of measurements; move it away, or give another --out") from None
    if rest:
        with atomic_file(log) as file:
            file.write(f"{whole}\n".encode() if whole else b"")
    return rows


def _measured(method: Method, name: str, pair: Pair, key: str) -> Row:
    a, b = pair.rasters()
    start = time.process_time()
    answer = method(a, b)
    seconds = time.process_time() - start
    error = None
    if answer.b_from_a is not None:
        error = round(label_error_px(answer.b_from_a, pair, (a.mask.shape, b.mask.shape)), 3)
    score = None if answer.score is None else round(answer.score, 1)
    diagonal = round(float(np.hypot(*b.mask.shape)), 1)
    return Row(name, pair.kind, pair.name, error, diagonal, round(seconds, 3), answer.inliers, score, key)
