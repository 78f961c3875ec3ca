# SPDX-License-Identifier: Apache-2.0
"""The run directory: stages that resume, products that are never half-written."""

from __future__ import annotations

import logging
import re
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from filelock import BaseFileLock

from skymoor.errors import InputError
from skymoor.store._atomic import atomic_folder, disk_errors, remove_leftovers
from skymoor.store._cache import KEY_LENGTH, STAGES, Corrupt, read_cache, write_parts, write_whole
from skymoor.store._closure import defining_modules, fingerprint, name_of
from skymoor.store._digest import digest, parts_of
from skymoor.store._files import FileDigests
from skymoor.store._kept import Kept
from skymoor.store._lock import lock_folder
from skymoor.store._marks import FRAMES, require_no_others_files
from skymoor.store._memory import peak_mib, reset_peak
from skymoor.store._products import Products
from skymoor.store.photos import (
    FoundFiles,
    PhotoFile,
    VideoOptions,
    check_photos,
    photos_of,
    require_enough,
    write_frames,
)
from skymoor.types import Photos, Progress, no_progress

T = TypeVar("T")

LOG = logging.getLogger("skymoor")
FROM_CACHE = "from the cache"
"""The note of the progress of a stage that was not computed again."""
UNCOUNTED = ("progress", "checkpoint")
"""Options of stages that change how the work goes on, and not what comes of it."""


@dataclass(frozen=True)
class StageRecord:
    """What a stage cost when it was computed; `cached` says that this run only read the result."""

    name: str
    key: str
    seconds: float
    peak_mib: float
    cached: bool


class Store(Products):
    """One run directory, held by one process. Use `Store.open`; it is also a context manager."""

    def __init__(self, root: Path, lock: BaseFileLock, note: Callable[[str], None]) -> None:
        super().__init__(root)
        self._lock = lock
        self._note = note
        self._records: dict[str, StageRecord] = {}
        self.files = FileDigests(root / STAGES / "files.json")

    @classmethod
    def open(cls, out: Path, note: Callable[[str], None] = lambda _: None) -> Store:
        """Make or reopen a run directory and lock it; `note` is called with one line for each irregularity.

        Raises `InputError` when it is a file, cannot be written, holds files of others that a run would overwrite, or
        another run holds it.
        """
        with disk_errors(out):
            if out.exists() and not out.is_dir():
                raise InputError(f"{out}: is a file; give a folder for the results with --out")
            require_no_others_files(out)
            (out / STAGES).mkdir(parents=True, exist_ok=True)
        lock = lock_folder(out, note)
        try:
            with (
                disk_errors(out),
                tempfile.TemporaryFile(dir=out / STAGES) as probe,
            ):  # now, not after an hour of work
                probe.write(b"\0")
        except InputError:
            lock.release()
            raise
        remove_leftovers(out)
        return cls(out.resolve(), lock, note)

    def close(self) -> None:
        """Let go of the directory; the end of the process does the same."""
        self._lock.release()

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
        self, name: str, function: Callable[..., T], *inputs: Any, depends_on: object = None, **options: Any
    ) -> T:
        """The result of `function(*inputs, **options)`, from the cache where nothing that it depends on has changed.

        It depends on the source text of the module that defines the function and of all that it imports from this
        package, likewise for the types of the inputs and options; on the content of inputs and options, where a path
        stands for the content of its file (see `digest`); on the weights that an engine among them reads; and on
        `depends_on`, which the function is not given. So no stage names the stages before it: what has changed in them
        shows in their results. Options called `progress` and `checkpoint` change no result and do not count. A damaged
        cache file is computed again; files of the stage with another key are removed after success.

        Raises `ValueError` for a name that is used twice and for a local function.
        """
        key, compute = self._call(function, inputs, options, depends_on)
        value: T = self._kept(name, key, compute, progress=options.get("progress", no_progress))
        return value

    def parts(self, name: str, function: Callable[..., Iterable[T]], *inputs: Any, **options: Any) -> Kept[T]:
        """As `stage`, for a result of many large parts, each of which is written as soon as the function yields it.

        They are read from the disk one at a time; a later stage's result that holds them refers to their file.
        """
        key, compute = self._call(function, inputs, options, None)
        progress = options.get("progress", no_progress)
        kept: Kept[T] = self._kept(name, key, compute, progress=progress, keep=write_parts)
        return kept

    def _call(
        self, function: Callable[..., T], inputs: Sequence[Any], options: Mapping[str, Any], depends_on: object
    ) -> tuple[str, Callable[[], T]]:
        """The key of a stage, and its work."""
        given = [*inputs, *(value for key, value in options.items() if key not in UNCOUNTED)]

        def compute() -> T:
            options.get("progress", no_progress)(0, 1)  # it begins; how much there is to do, the function knows
            return function(*inputs, **options)

        return self._key(function, given, sorted(options), depends_on), compute

    def photos(
        self, name: str, found: FoundFiles, video: VideoOptions | None = None, progress: Progress = no_progress
    ) -> Photos:
        """The photos of a set; the slow check of every file is the stage `name` and is not repeated when resuming.

        Frames of videos are written to the folder frames/ of the run, named as the video and the frame's number, by a
        stage for each video. Stages that read the photos depend on their names and content, wherever the folder lies.

        Raises `InputError` as `open_photos` and `write_frames`, and for fewer than 3 photos and frames together.
        """
        files = list(found.photos)
        for k, one in enumerate(found.videos):
            files += self._frames(f"{name}.video{k}", one, video or VideoOptions(), progress)
        where = ", ".join(one.name for one in found.videos) or name
        require_enough(where, len(files), found.notes)
        content = tuple((file.name, self.files.sha256(file.path)) for file in files)
        key = self._key(check_photos, [content], [], None)
        sizes = self._kept(name, key, lambda: check_photos(files, progress), progress=progress)
        return photos_of(files, sizes, content)

    def _frames(self, name: str, video: PhotoFile, options: VideoOptions, progress: Progress) -> list[PhotoFile]:
        """The chosen frames of a video; written again where they are no longer what was written."""
        folder = self.path(FRAMES, video.name)

        def stamped(names: Iterable[str]) -> tuple[tuple[str, str], ...]:
            return tuple((one, self.files.sha256(folder / one)) for one in names)

        def written() -> tuple[tuple[str, str], ...]:
            names: list[str] = []
            atomic_folder(folder, lambda fresh: names.extend(write_frames(video.path, fresh, options, progress)))
            return stamped(names)

        key = self._key(write_frames, [video.path, video.name, options], [], None)
        frames = self._kept(name, key, written, lambda kept: kept == stamped(one for one, _ in kept))
        return [PhotoFile(f"{video.name}/{one}", folder / one) for one, _ in frames]

    def _key(
        self, function: Callable[..., object], given: Sequence[object], names: Sequence[str], extra: object
    ) -> str:
        parts = [part for value in (function, *given) for part in parts_of(value)]
        read = [self.files.stamps(value.ready()) for value in (function, *given) if hasattr(value, "ready")]
        settings = function if is_dataclass(function) else None
        code = fingerprint(defining_modules(function, parts))
        return digest([code, name_of(function), settings, given, names, read, extra], self.files.sha256)

    def _kept(
        self,
        name: str,
        key: str,
        compute: Callable[[], T],
        still: Callable[[T], bool] = lambda _: True,
        progress: Progress = no_progress,
        keep: Callable[[Path, T, Callable[[], StageRecord]], tuple[StageRecord, Any]] = write_whole,
    ) -> Any:
        """The result that is kept under this key and is `still` valid, else that of `compute`, kept by `keep`."""
        if not re.fullmatch(r"[a-z0-9][a-z0-9_.-]*", name) or name in self._records:
            raise ValueError(f"stage name {name!r} is not usable or was used before")
        file = self.root / STAGES / f"{name}-{key[:KEY_LENGTH]}.npz"
        cached = self._cached(name, key, file)
        if cached is not None and still(cached[1]):
            record, value = cached
            LOG.info("%s: %s", name, FROM_CACHE)
            progress(1, 1, FROM_CACHE)
        else:
            reset_peak()
            start = time.perf_counter()
            LOG.info("%s: begins", name)
            record, value = keep(
                file,
                compute(),
                lambda: StageRecord(name, key, time.perf_counter() - start, peak_mib(), cached=False),
            )
            LOG.info("%s: %.1f s, at most %.0f MiB", name, record.seconds, record.peak_mib)
        self._records[name] = record
        self.files.save()
        self._forget_others(name, file)
        return value

    def clean(self) -> int:
        """Delete the cache, which the same run would compute again; returns how many bytes that frees."""
        folder = self.root / STAGES
        files = [path for path in folder.rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files)
        with disk_errors(folder):
            for path in files:
                path.unlink(missing_ok=True)
        self.files.forget()
        return size

    def scratch(self, stage: str) -> Path:
        """A file for the unfinished work of a stage; the stage removes it when it is done."""
        return self.root / STAGES / f"{stage}.unfinished"

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
        pattern = re.compile(rf"{re.escape(name)}-[0-9a-f]{{{KEY_LENGTH}}}\.npz")
        for other in file.parent.iterdir():
            if other != file and pattern.fullmatch(other.name):
                with suppress(OSError):  # room that is not won back is no reason to stop
                    other.unlink(missing_ok=True)
