# SPDX-License-Identifier: Apache-2.0
"""The files of a set of photos: in folders and their sub-folders, by name."""

from __future__ import annotations

import os
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from skymoor.errors import InputError
from skymoor.store._marks import holds_a_run
from skymoor.store.photos.kinds import SUFFIXES, VIDEOS, UnreadableKind, is_photo, is_video, unreadable_kind

FEWEST_PHOTOS = 3
NAMED = 3
# Thumbnails of network storage, what archives of macOS carry along, and what was deleted: no photos of the user's.
FOREIGN_FOLDERS = ("@eaDir", "__MACOSX", "$RECYCLE.BIN", "lost+found")


@dataclass(frozen=True)
class PhotoFile:
    """A file, and its name in all results: relative to the site, with forward slashes."""

    name: str
    path: Path


@dataclass(frozen=True)
class FoundFiles:
    """The files of a set: photos and videos by name, and one line for each kind of file that is left out."""

    photos: tuple[PhotoFile, ...]
    videos: tuple[PhotoFile, ...] = ()
    notes: tuple[str, ...] = ()


def find_photos(sources: Sequence[Path], root: Path, others: Collection[Path] = ()) -> FoundFiles:
    """The photos and videos of a set: those in folders and their sub-folders, and videos that are named themselves.

    Names are relative to `root` with forward slashes; those of a folder outside of `root` begin with its name. Passed
    over are hidden files and folders, folders of runs, links to folders, and what `others` names: files and folders
    that are something else, such as the reference. Files that look like photos and cannot be read are in the notes.

    Raises `InputError` for a source that is missing or can neither be read nor is a folder or video, for a set without
    photos or videos, for fewer than 3 photos and no video, and for a name that is not text.
    """
    walk = _Walk(frozenset(map(os.path.realpath, others)))
    found: dict[str, Path] = {}
    for source in sources:
        prefix = name_prefix(source, root)
        for path in walk.files(source):
            name = prefix if path == source else prefix / path.relative_to(source)
            found.setdefault(name.as_posix(), path)
    ordered = [PhotoFile(name, found[name]) for name in sorted(found, key=lambda name: Path(name).parts)]
    photos = [file for file in ordered if is_photo(file.path)]
    stems = {file.path.with_suffix("") for file in photos}
    videos = [file for file in ordered if is_video(file.path) and file.path.with_suffix("") not in stems]
    notes = [*_about_folders(sources, photos, walk.links), *_about_unreadable(ordered, stems)]
    _require_photos(sources, photos, videos, notes)
    return FoundFiles(tuple(photos), tuple(videos), tuple(notes))


def require_enough(where: str, count: int, notes: Sequence[str] = ()) -> None:
    """Raises `InputError` where so few photos cannot be a set; `notes` say what else was there."""
    if count < FEWEST_PHOTOS:
        raise InputError("; ".join([f"{where}: has {count} images, at least {FEWEST_PHOTOS} are needed", *notes]))


def name_prefix(source: Path, root: Path) -> Path:
    """What the names of a folder's photos begin with, see `find_photos`."""
    inside, root = source.resolve(), root.resolve()
    return inside.relative_to(root) if inside.is_relative_to(root) else Path(inside.name)


class _Walk:
    """Goes through folders; keeps the links to folders that it met."""

    def __init__(self, others: frozenset[str]) -> None:
        self._others = others
        self.links: list[Path] = []

    def files(self, source: Path) -> Iterator[Path]:
        """Files of a source that are meant to be photos or videos."""
        if source.is_file():
            if not is_video(source):
                raise InputError(f"{source}: is a file; give the folder of the photos, or a video")
            yield source
            return
        if not source.is_dir():
            raise InputError(f"{source}: there is no such folder of images")
        # Links are not followed: they may lead out of the folder, or in a circle.
        for name, folders, files in os.walk(source, onerror=_cannot_be_read):
            folder = Path(name)
            folders[:] = [one for one in sorted(folders) if self._is_ours(folder / one)]
            for file in sorted(files):
                path = folder / file
                known = is_photo(path) or is_video(path) or unreadable_kind(path) is not None
                if known and not file.startswith(".") and os.path.realpath(path) not in self._others:
                    _require_text(path, path.relative_to(source))
                    if _is_file(path):
                        yield path

    def _is_ours(self, folder: Path) -> bool:
        if folder.name.startswith(".") or folder.name in FOREIGN_FOLDERS or os.path.realpath(folder) in self._others:
            return False
        if folder.is_symlink():
            self.links.append(folder)
            return False
        return not holds_a_run(folder)


def _cannot_be_read(error: OSError) -> None:
    raise InputError(f"{error.filename}: cannot be read: {error.strerror or error}") from error


def _is_file(entry: Path) -> bool:
    """Devices are passed over; a file that is meant to be a photo and cannot be used is reported."""
    if entry.is_symlink() and not entry.exists():
        raise InputError(f"{entry}: is a link to nothing; remove it, or put the photo where it points")
    return entry.is_file()


def _require_text(entry: Path, name: Path) -> None:
    """Tables, XML and COLMAP models hold names as text in UTF-8, on one line."""
    if any(unicodedata.category(one) in ("Cc", "Cs", "Zl", "Zp") or ord(one) & 0xFFFE == 0xFFFE for one in str(name)):
        raise InputError(f"{str(entry)!r}: its name is not readable text; rename it")


def _about_folders(sources: Sequence[Path], photos: Sequence[PhotoFile], links: Sequence[Path]) -> Iterator[str]:
    for source in sources:
        below = [file.path.relative_to(source).parent for file in photos if file.path.is_relative_to(source)]
        counts = Counter(folder.as_posix() for folder in below if folder != Path())
        if counts:
            each = [f"{folder} ({count})" for folder, count in counts.items()]
            yield f"{source}: {counts.total()} of {len(below)} photos are in sub-folders: {_listed(each)}"
    if links:
        names = _listed([str(link) for link in links])
        yield f"links to folders are not followed: {names}; name such a folder itself if it is part of the set"


def _about_unreadable(files: Sequence[PhotoFile], stems: Collection[Path]) -> Iterator[str]:
    """One line for each kind of file that is left out; copies of photos in another format are no loss."""
    kinds: dict[UnreadableKind, list[PhotoFile]] = {}
    copies: list[PhotoFile] = []
    clips: list[PhotoFile] = []
    for file in files:
        kind, stem = unreadable_kind(file.path), file.path.with_suffix("")
        if stem in stems and (kind is not None or is_video(file.path)):
            (clips if kind is None else copies).append(file)
        elif kind is not None:
            kinds.setdefault(kind, []).append(file)
    for kind, left_out in kinds.items():
        yield f"left out: {_counted(left_out, kind.name)}, which cannot be read; {kind.remedy}"
    if copies:
        yield f"left out: {_counted(copies, 'raw or other file')} beside a photo of the same name, which is read"
    if clips:
        yield f"left out: {_counted(clips, 'short video')} beside a photo of the same name, which is read"


def _counted(files: Sequence[PhotoFile], what: str) -> str:
    return f"{len(files)} {what}{'s' if len(files) > 1 else ''} ({_listed([file.name for file in files])})"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:NAMED]) + (", ..." if len(names) > NAMED else "")


def _require_photos(
    sources: Sequence[Path], photos: Sequence[PhotoFile], videos: Sequence[PhotoFile], notes: Sequence[str]
) -> None:
    where = ", ".join(map(str, sources))
    if not photos and not videos:
        kinds = ", ".join(suffix[1:] for suffix in (*SUFFIXES, *VIDEOS))
        raise InputError("; ".join([f"{where}: has no images, also not in sub-folders ({kinds})", *notes]))
    if not videos:
        require_enough(where, len(photos), notes)
