# SPDX-License-Identifier: Apache-2.0
"""Fetching weights: a file is there whole and checked, or not at all."""

from __future__ import annotations

import shutil
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit
from zipfile import BadZipFile, ZipFile

from skymoor.engines.download import PREFIX, Fetched, FileProgress, download
from skymoor.engines.temporary import temporary_folder
from skymoor.engines.weights.files import sha256_of, verify
from skymoor.engines.weights.table import WeightFile, known
from skymoor.errors import BackendUnavailable, InputError


def fetch(name: str, folder: Path, progress: Callable[[str], FileProgress]) -> list[Fetched]:
    """Download all files of known weights that `folder`/`name` does not hold yet.

    Args:
        name: of the table.
        folder: of all weights; made if it is missing.
        progress: makes the callback for a file.

    Raises:
        InputError: the name is unknown, a download failed, or a file is not the expected one. A file that is there
            and is not the expected one is never overwritten.
        BackendUnavailable: a repository of a hub is needed, and its library is not installed.
    """
    done = []
    for file in known(name).files:
        path = folder / name / file.file
        there = path.exists()
        if there and file.sha256:
            verify(path, file.sha256)
        if not there:
            _fetch_new(file, path, progress)
        done.append(Fetched(path, None if file.folder else sha256_of(path), there))
    return done


def _fetch_new(file: WeightFile, path: Path, progress: Callable[[str], FileProgress]) -> None:
    _make_room(path)
    if file.folder:
        _fetch_folder(file, path)
    else:
        _fetch_file(file, path, progress(path.name))


def _make_room(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be written ({error.strerror}); choose another --to") from error


def _fetch_file(file: WeightFile, path: Path, progress: FileProgress) -> None:
    if urlsplit(file.url).scheme not in ("https", "file"):
        raise InputError(f"{file.url}: weights come from https or file addresses only")
    if file.member:
        _fetch_member(file, path, progress)
    else:
        download(file.url, path, sha256=file.sha256, size_mb=file.size_mb, progress=progress)


def _fetch_member(file: WeightFile, path: Path, progress: FileProgress) -> None:
    """A file out of the archive at its address."""
    with temporary_folder(path.parent, PREFIX) as temporary:
        archive, part = temporary / "archive", temporary / path.name
        by_hand = f"put {file.member} of it by hand at {path}"
        download(file.url, archive, size_mb=file.size_mb, progress=progress, by_hand=by_hand)
        try:
            with ZipFile(archive) as content, content.open(file.member) as source, part.open("wb") as target:
                shutil.copyfileobj(source, target)
        except (BadZipFile, KeyError, zlib.error) as error:
            reason = str(error).strip("'\"")
            raise InputError(f"{file.url}: not the archive that skymoor knows ({reason}); nothing is kept") from None
        if file.sha256 not in (None, found := sha256_of(part)):
            raise InputError(
                f"{file.url}: {file.member} is not the file that skymoor knows (sha256 {found}, expected "
                f"{file.sha256}); nothing is kept"
            )
        part.replace(path)


def _fetch_folder(file: WeightFile, path: Path) -> None:
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        raise BackendUnavailable(
            f"{file.url}: fetching a repository takes a library: pip install huggingface_hub; "
            f"or put its files by hand in {path}"
        ) from error
    temporary = Path(tempfile.mkdtemp(prefix=PREFIX, dir=path.parent))
    try:
        part = temporary / path.name
        repository = urlsplit(file.url).path.strip("/")
        snapshot_download(repository, local_dir=part, ignore_patterns=[*file.skip, "*.onnx", "*.h5", "*.msgpack"])
        shutil.rmtree(part / ".cache", ignore_errors=True)
        part.replace(path)
    except (OSError, ValueError, RuntimeError) as error:  # the library's own errors are all of these kinds
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{file.url}: cannot be fetched ({reason}); try again, or put its files by hand in {path}"
        ) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
