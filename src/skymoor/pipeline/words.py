# SPDX-License-Identifier: Apache-2.0
"""Sizes and times as a person says them."""

from __future__ import annotations

SIZES = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
TIMES = ((86400.0, "days"), (3600.0, "h"), (60.0, "min"))


def size_in_words(count: float) -> str:
    """Bytes, such as 1.2 GB."""
    for size, unit in SIZES:
        if count >= 0.95 * size:
            return f"{count / size:.{0 if count >= 9.5 * size else 1}f} {unit}"
    return f"{count:.0f} bytes"


def time_in_words(seconds: float) -> str:
    """Such as 4 min; two figures, no more than an estimate deserves."""
    for size, unit in TIMES:
        if seconds >= 1.5 * size:
            return f"{seconds / size:.{0 if seconds >= 9.5 * size or unit == 'min' else 1}f} {unit}"
    return f"{seconds:.0f} s"
