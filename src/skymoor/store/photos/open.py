# SPDX-License-Identifier: Apache-2.0
"""A set of photos as the stages take it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skymoor.store.photos.decode import decoded, size_of
from skymoor.store.photos.files import PhotoFile, find_photos
from skymoor.types import Photos, Progress, no_progress


def open_photos(folder: Path, root: Path, progress: Progress = no_progress) -> Photos:
    """The photos of a folder and its sub-folders, by name; every one is decoded once as a check. Without videos.

    Photos are read as they are stored: the EXIF orientation is ignored on purpose, since what counts is the sensor's
    raster. Grey and 16-bit images become 8-bit RGB. Of several images in one file the first counts.

    Raises `InputError` as `find_photos`, and for a photo that cannot be decoded to its end, or is too large, too small
    or too long.
    """
    files = find_photos([folder], root).photos
    return photos_of(files, check_photos(files, progress))


def check_photos(files: Sequence[PhotoFile], progress: Progress = no_progress) -> tuple[tuple[int, int], ...]:
    """Decode every photo with two threads; sizes (width, height) in their order. Errors as `open_photos`."""
    sizes: list[tuple[int, int]] = []
    progress(0, len(files))
    with ThreadPoolExecutor(max_workers=2) as pool:
        try:
            for size in pool.map(size_of, (file.path for file in files)):
                sizes.append(size)
                progress(len(sizes), len(files))
        finally:
            pool.shutdown(cancel_futures=True)
    return tuple(sizes)


def photos_of(files: Sequence[PhotoFile], sizes: Sequence[tuple[int, int]], content: object = None) -> Photos:
    """Photos that `check_photos` has passed; `content` stands for all their pixels in the keys of stages."""
    names = tuple(file.name for file in files)
    return Photos(names, tuple(sizes), _Reader(tuple((file.name, file.path) for file in files)), content)


@dataclass(frozen=True)
class _Reader:
    """Reads a photo by name; a class, because unlike a closure it can go to another process."""

    files: tuple[tuple[str, Path], ...]

    def __call__(self, name: str) -> NDArray[np.uint8]:
        return decoded(dict(self.files)[name])
