# SPDX-License-Identifier: Apache-2.0
"""Digests of files, computed once: each is kept beside the cache with size and time of change of its file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from skymoor.engines.regular import regular
from skymoor.store._atomic import atomic_file


class FileDigests:
    """SHA-256 of files by their content: a copied or restored file is the same, an edited one is another."""

    def __init__(self, index: Path) -> None:
        self._index = index
        self._known: dict[str, list[object]] | None = None
        self._changed = False

    def sha256(self, file: Path) -> str:
        """In hexadecimal; the path itself for what is no file that can be read."""
        try:
            status, path = file.stat(), str(file.resolve())
            stamp: list[object] = [status.st_size, status.st_mtime_ns]
            known = self._load().get(path)
            if known is None or known[:2] != stamp:
                with file.open("rb") as content:
                    known = [*stamp, hashlib.file_digest(content, "sha256").hexdigest()]
                self._load()[path] = known
                self._changed = True
        except OSError:
            return file.as_posix()
        return str(known[2])

    def stamps(self, paths: Iterable[Path]) -> list[tuple[str, int, int]]:
        """Name, size and time of change of files too large to be hashed, as weights, and of all files in folders."""
        files = [file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
        return [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.is_file()]

    def forget(self) -> None:
        """Drop all digests."""
        self._known = {}

    def save(self) -> None:
        """Keep what is known for the next run; without it files are read again."""
        if self._changed and self._index.parent.is_dir():
            with suppress(Exception), atomic_file(self._index) as out:
                out.write(json.dumps(self._known).encode())
            self._changed = False

    def _load(self) -> dict[str, list[object]]:
        if self._known is None:
            self._known = {}
            with suppress(OSError, ValueError, TypeError, AttributeError, RecursionError):
                found = json.loads(regular(self._index).read_text(encoding="utf-8"))
                self._known = {key: value for key, value in found.items() if len(value) == 3}
        return self._known
