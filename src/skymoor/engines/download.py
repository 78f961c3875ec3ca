# SPDX-License-Identifier: Apache-2.0
"""Downloads: a file is there whole and checked, or not at all. Only commands that are called fetch use this."""

from __future__ import annotations

import hashlib
import http.client
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from skymoor.engines.temporary import temporary_folder
from skymoor.errors import InputError

FileProgress = Callable[[int, int], object]
"""Called with the megabytes that are there and those in all."""

TIMEOUT_S = 60.0
CHUNK = 1 << 20
PREFIX = ".skymoor-"


@dataclass(frozen=True)
class Fetched:
    """A file or folder that is there now; the digest of a file, and whether it was there before."""

    path: Path
    sha256: str | None
    was_there: bool


def download(
    url: str,
    path: Path,
    *,
    sha256: str | None = None,
    size_mb: float | None = None,
    progress: FileProgress = lambda done, total: None,
    by_hand: str = "",
) -> None:
    """Download a file into an existing folder, under another name first, so that an interruption leaves nothing.

    `sha256` is the digest that it must have, `size_mb` about its size where the server does not say it, `by_hand` what
    to do where the network is of no use.
    Raises `InputError` when it cannot be fetched, breaks off, or is not the expected one; nothing is kept then.
    """
    with temporary_folder(path.parent, PREFIX) as temporary:
        part = temporary / path.name
        _download(url, part, size_mb, progress, by_hand or f"put it by hand at {path}")
        with part.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        if sha256 not in (None, found):
            raise InputError(
                f"{url}: not the file that skymoor knows (sha256 {found}, expected {sha256}); nothing is kept"
            )
        part.replace(path)


def _download(url: str, part: Path, size_mb: float | None, progress: FileProgress, by_hand: str) -> None:
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as source, part.open("wb") as target:
            length = int(source.headers.get("Content-Length") or 0)
            total = max(1, round((length or (size_mb or 0) * 1e6) / 1e6))
            size = 0
            while chunk := source.read(CHUNK):
                target.write(chunk)
                size += len(chunk)
                progress(min(size // 1_000_000, total - 1), total)
    except (urllib.error.URLError, http.client.HTTPException, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise InputError(f"{url}: cannot be fetched ({reason}); try again, or {by_hand}") from None
    if length and size != length:
        raise InputError(f"{url}: the download broke off after {size} of {length} bytes; try again")
    progress(total, total)
