# SPDX-License-Identifier: Apache-2.0
"""The run directory: stages that resume, products that are never half-written."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import logging
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from skymoor import __version__
from skymoor.errors import InputError
from skymoor.store._atomic import atomic_file, atomic_folder, disk_errors, remove_leftovers
from skymoor.store._cache import Corrupt, read_cache, write_cache
from skymoor.store._digest import code_fingerprint, digest
from skymoor.store._memory import peak_mib, reset_peak
from skymoor.store._photos import check_photos, photos_fingerprint, photos_from_sizes
from skymoor.types import Photos, Progress, no_progress

T = TypeVar("T")

LOG = logging.getLogger("skymoor")
KEY_LENGTH = 12

PRODUCTS = (
    *("summary.json", "cameras.csv", "cameras.geojson", "colmap", "pointcloud.laz", "ortho.tif", "dsm.tif"),
    *("renders", "matches", "evaluation.json", "report.html", "run.log", "stages"),
)
"""What skymoor writes into a run directory, or deletes from it."""
MARKS = (".lock", "summary.json", "stages")
"""By one of these a folder is known as a run directory."""


@dataclass(frozen=True)
class StageRecord:
    """What a stage cost when it was computed; `cached` says that this run only read the result."""

    name: str
    key: str
    seconds: float
    peak_mib: float
    cached: bool


class Store:
    """One run directory, held by one process. Use `Store.open`; it is also a context manager.

    The cache under stages/ is pickle: open run directories only from people whose programs you would run.
    """

    def __init__(self, root: Path, lock: int, note: Callable[[str], None]) -> None:
        self.root = root
        self._lock: int | None = lock
        self._note = note
        self._records: dict[str, StageRecord] = {}

    @classmethod
    def open(cls, out: Path, note: Callable[[str], None] = lambda _: None) -> Store:
        """Make or reopen a run directory and lock it; `note` is told in one line of anything odd.

        Raises `InputError` when it is a file, cannot be written, holds files of others that a run would overwrite, or
        another run holds it.
        """
        with disk_errors(out):
            if out.exists() and not out.is_dir():
                raise InputError(f"{out}: is a file; give a folder for the results with --out")
            _require_no_others_files(out)
            (out / "stages").mkdir(parents=True, exist_ok=True)
            lock = os.open(out / ".lock", os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            raise InputError(
                f"{out}: another run is writing here; wait for it or give another folder with --out"
            ) from None
        except OSError as error:
            note(f"{out}: this file system has no locks ({error.strerror}); do not start a second run here")
        try:
            with (
                disk_errors(out),
                tempfile.TemporaryFile(dir=out / "stages") as probe,
            ):  # now, not after an hour of work
                probe.write(b"\0")
        except InputError:
            os.close(lock)
            raise
        remove_leftovers(out)
        return cls(out.resolve(), lock, note)

    def close(self) -> None:
        """Let go of the directory; the end of the process does the same."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def records(self) -> tuple[StageRecord, ...]:
        """The stages of this run, in order."""
        return tuple(self._records.values())

    def stage(
        self,
        name: str,
        compute: Callable[[], T],
        *,
        options: object = None,
        after: Sequence[str] = (),
        code: Sequence[ModuleType | str] = (),
    ) -> T:
        """The result of `compute`, from the cache where nothing that it depends on has changed.

        It depends on the version of skymoor, the source text of the modules in `code` (of all modules below, for a
        package), the `options` (see `digest`) and the stages in `after`, which must have run before. A damaged cache
        file is computed again; files of the stage with another key are removed after success.
        """
        if not re.fullmatch(r"[a-z0-9][a-z0-9_.-]*", name) or name in self._records:
            raise ValueError(f"stage name {name!r} is not usable or was used before")
        earlier = [self._records[other].key for other in after]
        key = digest([__version__, name, code_fingerprint(code), options, earlier])
        file = self.root / "stages" / f"{name}-{key[:KEY_LENGTH]}.pkl"
        cached = self._cached(name, key, file)
        if cached is not None:
            record, value = cached
            LOG.info("%s: from the cache", name)
        else:
            reset_peak()
            start = time.perf_counter()
            LOG.info("%s: begins", name)
            value = compute()
            record = StageRecord(name, key, time.perf_counter() - start, peak_mib(), cached=False)
            write_cache(file, record, value)
            LOG.info("%s: %.1f s, at most %.0f MiB", name, record.seconds, record.peak_mib)
        self._records[name] = record
        self._forget_others(name, file)
        return value  # type: ignore[no-any-return]

    def photos(self, name: str, folder: Path, root: Path, progress: Progress = no_progress) -> Photos:
        """`open_photos`, where the slow check of every file is the stage `name` and is not repeated when resuming.

        Give `name` in the `after` of the stages that read the photos.
        """
        sizes = self.stage(name, lambda: check_photos(folder, progress), options=photos_fingerprint(folder))
        return photos_from_sizes(folder, root, sizes)

    def path(self, *parts: str) -> Path:
        """Where a product lies. Raises `ValueError` for a path outside of the run directory."""
        path = self.root.joinpath(*parts)
        if not Path(os.path.normpath(path)).is_relative_to(self.root):
            raise ValueError(f"{path} is outside of {self.root}")
        return path

    def scratch(self, stage: str) -> Path:
        """A file for the unfinished work of a stage; the stage removes it when it is done."""
        return self.root / "stages" / f"{stage}.unfinished"

    def write_bytes(self, name: str, content: bytes) -> Path:
        """Write a file whole; `name` is relative to the run directory and may hold folders."""
        target = self.path(name)
        with atomic_file(target) as file:
            file.write(content)
        return target

    def write_text(self, name: str, text: str) -> Path:
        """Write UTF-8 text."""
        return self.write_bytes(name, text.encode())

    def write_json(self, name: str, value: object) -> Path:
        """Write JSON; dataclasses become objects, arrays lists, paths text, and numbers that are not finite null."""
        return self.write_text(name, json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n")

    def write_csv(self, name: str, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> Path:
        """Write a table with a header; None becomes an empty cell and floats keep all their digits."""
        buffer = io.StringIO(newline="")
        writer = csv.DictWriter(buffer, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return self.write_text(name, buffer.getvalue())

    def write_png(self, name: str, rgb: NDArray[np.uint8]) -> Path:
        """Write a picture (h, w, 3) RGB, (h, w, 4) RGBA or (h, w) grey."""
        buffer = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(rgb, dtype=np.uint8)).save(buffer, format="png")
        return self.write_bytes(name, buffer.getvalue())

    def write_npz(self, name: str, **arrays: NDArray[Any]) -> Path:
        """Write named arrays, compressed."""
        if any(array.dtype.hasobject for array in arrays.values()):
            raise TypeError("arrays of objects are not written")
        target = self.path(name)
        with atomic_file(target) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # newer numpy takes a flag by name
        return target

    def write_folder(self, name: str, fill: Callable[[Path], object]) -> Path:
        """Let `fill` write a folder of files, which then replaces the one of that name as a whole."""
        target = self.path(name)
        atomic_folder(target, fill)
        return target

    def remove(self, name: str) -> None:
        """Delete a product of an earlier run, file or folder, if there is one."""
        target = self.path(name)
        with disk_errors(target):
            if target.is_dir() and not target.is_symlink():
                shutil.rmtree(target)
            else:
                target.unlink(missing_ok=True)

    def _cached(self, name: str, key: str, file: Path) -> tuple[StageRecord, Any] | None:
        try:
            record, value = read_cache(file)
        except FileNotFoundError:
            return None
        except Corrupt as error:
            self._note(f"stage {name}: the cache {file.name} is damaged ({error}) and is computed again")
            return None
        if not isinstance(record, StageRecord) or record.key != key:
            self._note(f"stage {name}: the cache {file.name} belongs to something else and is computed again")
            return None
        return replace(record, cached=True), value

    def _forget_others(self, name: str, file: Path) -> None:
        pattern = re.compile(rf"{re.escape(name)}-[0-9a-f]{{{KEY_LENGTH}}}\.pkl")
        for other in file.parent.iterdir():
            if other != file and pattern.fullmatch(other.name):
                with suppress(OSError):  # room that is not won back is no reason to stop
                    other.unlink(missing_ok=True)


def _require_no_others_files(out: Path) -> None:
    """A folder without a trace of a run may hold an ortho.tif, but then it is not skymoor's to replace or delete."""
    if any((out / mark).exists() for mark in MARKS):
        return
    for name in PRODUCTS:
        if (out / name).exists():
            raise InputError(
                f"{out / name}: is not of a run, and a run would replace it; give another folder with --out"
            )


def plain(value: object) -> object:
    """What the JSON encoder understands."""
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, Path):
        return value.as_posix()
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    raise TypeError(f"{type(value).__qualname__} cannot be written as JSON")
