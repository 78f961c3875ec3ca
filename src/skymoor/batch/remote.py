# SPDX-License-Identifier: Apache-2.0
"""Results in an object store, at addresses that fsspec opens, such as s3://bucket/results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skymoor.engines.libraries import require
from skymoor.engines.temporary import is_kept, temporary_folder
from skymoor.errors import InputError, SkymoorError
from skymoor.results.report.write import PAGE
from skymoor.store import LOCK, STAGES

PART = ".skymoor-part"
LAST = (PAGE, "summary.json")
"""Files that describe all others of a run, in the order in which they are sent."""
Stamps = dict[str, tuple[int, int]]
"""Size and time of change of files, by their names relative to a folder."""


class Address(str):
    """Of a folder or a file in a store. Folders are joined with `/`, as those of a `Path`."""

    __slots__ = ()

    def __truediv__(self, name: str) -> Address:
        return Address(f"{self.removesuffix('/')}/{name}")

    @property
    def in_memory(self) -> bool:
        """Whether the store is the memory of this process, which no other one sees."""
        return self.startswith("memory:")


def path_or_address(out: str) -> Path | Address:
    """What a user named as the place of results."""
    return Address(out) if "://" in out else Path(out)


@contextmanager
def folder_of(out: Path | Address) -> Iterator[Path]:
    """The folder of a site's results, made where it is missing.

    That of an address is temporary: what lies there is fetched first, and sent back when the block ends without an
    error, whatever came of the run. Other errors are those of the disk.

    Raises:
        BackendUnavailable: fsspec is not installed.
        InputError: the store cannot be read or written; one line says why.
    """
    if isinstance(out, Path):
        out.mkdir(parents=True, exist_ok=True)
        yield out
        return
    with temporary_folder() as folder:
        before = fetch_folder(out, folder)
        yield folder
        now = _stamps_of(folder)
        if not is_kept(folder):  # or what is missing here would be deleted there
            raise InputError(f"{out}: nothing was sent, since the process is ending; the same command continues")
        send_folder(folder, out, before, now)


def fetch_folder(address: Address, folder: Path) -> Stamps:
    """Copy all that lies at an address into a folder; returns the stamps of the copies. Errors as of `folder_of`."""
    with _told(address, "read"):
        files, root = _opened(address)
        found = files.find(root) if files.exists(root) else []
        for path in found:
            if path.endswith(PART):  # of a copy that broke off
                files.rm_file(path)
                continue
            target = folder / path[len(root) + 1 :]
            if not target.resolve().is_relative_to(folder.resolve()):
                raise InputError(f"{address}: {path} lies outside of it")
            target.parent.mkdir(parents=True, exist_ok=True)
            files.get_file(path, str(target))
    return _stamps_of(folder)


def send_folder(folder: Path, address: Address, before: Stamps, now: Stamps) -> None:
    """Put what has changed since `before` to an address, and delete there what is gone. Errors as of `folder_of`.

    As in a folder, the cache comes first and the summary last, so that none describes products of another run.
    """
    changed = sorted(name for name, stamp in now.items() if before.get(name) != stamp)
    stages = [name for name in changed if name.startswith(f"{STAGES}/")]
    products = [name for name in changed if name not in (*stages, *LAST)]
    last = [name for name in LAST if name in changed]
    with _told(address, "written"):
        files, root = _opened(address)
        for name in stages:
            _put(files, folder / name, f"{root}/{name}")
        for name in sorted((before.keys() - now.keys()) | (before.keys() & {*last})):
            files.rm_file(f"{root}/{name}")
        for name in (*products, *last):
            _put(files, folder / name, f"{root}/{name}")


def send_bytes(content: bytes, address: Address) -> None:
    """Put one file to its address. Errors as of `folder_of`."""
    with _told(address, "written"):
        files, path = _opened(address)
        files.pipe_file(path + PART, content)
        files.mv(path + PART, path)


def _stamps_of(folder: Path) -> Stamps:
    """Of all files of a run but its lock, which is of this machine."""
    stamps = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != LOCK:
            status = path.stat()
            stamps[name] = (status.st_size, status.st_mtime_ns)
    return stamps


def _put(files: Any, source: Path, path: str) -> None:
    """Under another name first: a copy that breaks off replaces nothing, also in stores that show half of a file."""
    files.put_file(str(source), path + PART)
    files.mv(path + PART, path)


def _opened(address: Address) -> tuple[Any, str]:
    """The store and the path in it. Object stores need no folders; asked for one, some would make a missing bucket."""
    on_disk = address.startswith(("file://", "local://"))
    files, path = require("fsspec.core", "dask").url_to_fs(str(address), **({"auto_mkdir": True} if on_disk else {}))
    files.invalidate_cache()  # others write there, too
    return files, path.rstrip("/")


@contextmanager
def _told(address: Address, done: str) -> Iterator[None]:
    """Say in one line what a store refused, with errors of whatever kind: each has its own library's."""
    try:
        yield
    except SkymoorError:
        raise
    except Exception as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        remedy = (
            "install that package with pip"
            if isinstance(error, ImportError)
            else "check the address, your rights there and the network; the same command continues"
        )
        raise InputError(f"{address}: cannot be {done} ({type(error).__name__}: {reason}); {remedy}") from error
