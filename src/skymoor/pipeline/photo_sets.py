# SPDX-License-Identifier: Apache-2.0
"""The sets of photos of a site: which files belong to each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from skymoor.errors import BackendUnavailable, InputError
from skymoor.pipeline.site import Site
from skymoor.store import (
    FoundFiles,
    VideoOptions,
    check_photos,
    count_frames,
    find_photos,
    name_prefix,
    require_enough,
    video_ready,
)
from skymoor.types import Progress

__all__ = ["PhotoSet", "find_sets", "notes_of", "or_too_few", "require_distinct", "sizes_of"]

FEW_PHOTOS = 8
"""A recommendation and no limit: of subsets of a real nadir flight one of 4 photos was registered, others of 4 to 8
were not. A depth needs three photos that show the same."""


@dataclass(frozen=True)
class PhotoSet:
    """One set of photos, "airborne" or "ground0" and so on: the folders and videos it is made of, and its files."""

    name: str
    sources: tuple[Path, ...]
    files: FoundFiles


def find_sets(site: Site) -> list[PhotoSet]:
    """The sets of a site, the airborne one first; nothing is decoded.

    A file belongs to one set: what another set or the reference names is passed over. Where PyAV is missing, videos
    beside photos are left out with a note. Raises `InputError` as `find_photos`, and `BackendUnavailable` where PyAV is
    missing and a video is named, or a set has nothing else.
    """
    files = [path for path in (site.reference.ortho, site.reference.dsm) if isinstance(path, Path)]
    sets = []
    for name, sources in site.sets:
        others = [source for other, there in site.sets if other != name for source in there]
        sets.append(PhotoSet(name, sources, _with_videos(find_photos(sources, site.root, [*files, *others]), sources)))
    return sets


def _with_videos(found: FoundFiles, sources: Sequence[Path]) -> FoundFiles:
    if not found.videos:
        return found
    try:
        video_ready()
    except BackendUnavailable as error:
        if not found.photos or any(source.is_file() for source in sources):
            raise BackendUnavailable(f"{found.videos[0].path}: {error}") from error
        where, names = ", ".join(map(str, sources)), ", ".join(video.name for video in found.videos)
        require_enough(where, len(found.photos), found.notes)
        note = f"left out: {len(found.videos)} video{'s' if len(found.videos) > 1 else ''} ({names}): {error}"
        return FoundFiles(found.photos, (), (*found.notes, note))
    return found


def notes_of(sets: Sequence[PhotoSet]) -> list[str]:
    """One line for each irregularity of their files."""
    return [note for one in sets for note in one.files.notes]


def sizes_of(one: PhotoSet, video: VideoOptions, track: Callable[[str], Progress]) -> tuple[tuple[int, int], ...]:
    """Sizes (width, height) of the photos of a set and of the frames of its videos, all decoded; writes nothing."""
    sizes = list(check_photos(one.files.photos, track(one.name))) if one.files.photos else []
    for file in one.files.videos:
        count, size = count_frames(file.path, video, track(file.name))
        sizes += [size] * count
    require_enough(", ".join(map(str, one.sources)), len(sizes), one.files.notes)
    return tuple(sizes)


def or_too_few(reason: str, count: int) -> str:
    """A reason for a refusal, with the one that lies behind it where there are only so many photos."""
    if count >= FEW_PHOTOS:
        return reason
    return (
        f"{reason}: {count} photos are too few; give at least {FEW_PHOTOS} that overlap their neighbours by 70 % or "
        "more, so that each part of the ground is in three of them"
    )


def require_distinct(site: Site) -> None:
    """Raises `InputError` where photos of two folders would have the same names, and could not be told apart."""
    folders = [source for _, sources in site.sets for source in sources]
    for k, folder in enumerate(folders):
        prefix = name_prefix(folder, site.root)
        twin = next((other for other in folders[:k] if name_prefix(other, site.root) == prefix), None)
        if twin is not None:
            raise InputError(f"{folder}: is named twice, or as {twin} is; name each folder of photos once, differently")
