# SPDX-License-Identifier: Apache-2.0
"""Limits of the system, such as those of ulimit: told before the work where it could only fail, else where it ended."""

from __future__ import annotations

from collections.abc import Iterator

from skymoor.errors import InputError

LEAST_BYTES = 2_400_000_000
"""Libraries alone map 2.1 GB, and COLMAP ends the process where it can start no thread."""
WORDS = (
    "failed to map segment",
    "cannot allocate memory",
    "cannot map zero-fill pages",
    "can't start new thread",
    "insufficient memory",
    "bad_alloc",
)


def require_address_space() -> None:
    """Raises `InputError` where this process may map so little that libraries would end it without a word."""
    try:
        import resource
    except ImportError:  # on Windows
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit not in (resource.RLIM_INFINITY, -1) and limit < LEAST_BYTES:
        raise InputError(
            f"this process may map {limit / 1e9:.1f} GB of memory, and needs {LEAST_BYTES / 1e9:.1f} at least, and "
            "more for large sites; raise the limit with ulimit -v"
        )


def no_memory(error: BaseException) -> str:
    """One line about an error that came of too little memory; empty for any other."""
    for one in _chain(error):
        if isinstance(one, MemoryError) or any(words in str(one).lower() for words in WORDS):
            reason = next(reversed(str(one).strip().splitlines()), "none left")
            return (
                f"there is not enough memory ({reason}); end other programs, raise the limit (ulimit -v), or scale the "
                "photos down; the same command continues from here"
            )
    return ""


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
