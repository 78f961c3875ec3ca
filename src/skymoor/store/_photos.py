# SPDX-License-Identifier: Apache-2.0
"""Folders of photos: found, checked and read as raw 8-bit RGB."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

from skymoor.errors import InputError
from skymoor.types import Photos, Progress, no_progress

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
FEWEST_PHOTOS = 3
DEEP_MODES = ("I", "I;16", "I;16L", "I;16B", "I;16N")
TIFF_XMP_TAG = 700


def open_photos(folder: Path, root: Path, progress: Progress = no_progress) -> Photos:
    """The photos directly in `folder`, by name; every one is decoded once to be sure of it.

    Names are relative to `root` with forward slashes; for a folder outside of `root` they are FOLDER/FILE. Photos
    are read as they are stored: the EXIF orientation is ignored on purpose, since what counts is the sensor's raster.
    Grey and 16-bit images become 8-bit RGB, the latter by dropping the lower byte.

    Raises `InputError` for a missing or empty folder, for fewer than 3 photos, and for one that cannot be decoded to
    its end.
    """
    return photos_from_sizes(folder, root, check_photos(folder, progress))


def check_photos(folder: Path, progress: Progress = no_progress) -> tuple[tuple[int, int], ...]:
    """Decode every photo with two threads; sizes (width, height) in the order of the names. Errors as `open_photos`."""
    files = _photo_files(folder)
    sizes: list[tuple[int, int]] = []
    progress(0, len(files))
    with ThreadPoolExecutor(max_workers=2) as pool:
        try:
            for size in pool.map(_checked_size, files):
                sizes.append(size)
                progress(len(sizes), len(files))
        finally:
            pool.shutdown(cancel_futures=True)
    return tuple(sizes)


def photos_from_sizes(folder: Path, root: Path, sizes: Sequence[tuple[int, int]]) -> Photos:
    """Photos of a folder that `check_photos` has passed."""
    files = _photo_files(folder)
    inside = folder.resolve()
    prefix = inside.relative_to(root.resolve()) if inside.is_relative_to(root.resolve()) else Path(inside.name)
    names = tuple((prefix / file.name).as_posix() for file in files)
    return Photos(names, tuple(sizes), _Reader(tuple(zip(names, files, strict=True))))


def photos_fingerprint(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Name, bytes and time of change (ns) of every photo: what a stage that reads them depends on."""
    return tuple((file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in _photo_files(folder))


def has_metadata(folder: Path) -> int:
    """How many photos carry an EXIF position or focal length, or XMP. Only the headers are read."""
    return sum(_carries_metadata(file) for file in _photo_files(folder))


@dataclass(frozen=True)
class _Reader:
    """Reads a photo by name; a class, because unlike a closure it can go to another process."""

    files: tuple[tuple[str, Path], ...]

    def __call__(self, name: str) -> NDArray[np.uint8]:
        return _decoded(dict(self.files)[name])


def _photo_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder of images")
    files = sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()
    )
    if not files:
        kinds = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise InputError(f"{folder}: has no images ({kinds}); sub-folders are not searched")
    if len(files) < FEWEST_PHOTOS:
        raise InputError(f"{folder}: has {len(files)} images, at least {FEWEST_PHOTOS} are needed")
    return files


def _checked_size(file: Path) -> tuple[int, int]:
    height, width = _decoded(file).shape[:2]
    return width, height


def _decoded(file: Path) -> NDArray[np.uint8]:
    """(h, w, 3) RGB. Pillow, unlike OpenCV, reports a file that ends too early."""
    try:
        with _quiet_pillow(), Image.open(file) as image:
            image.load()
            return _rgb(image, file)
    except Image.DecompressionBombError as error:
        raise InputError(f"{file}: is too large, scale it down: {error}") from error
    except UnidentifiedImageError as error:
        raise InputError(f"{file}: is not an image that can be read; remove it or copy it again") from error
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise InputError(f"{file}: is damaged ({error}); remove it or copy it again") from error


@contextmanager
def _quiet_pillow() -> Iterator[None]:
    """No warnings of Pillow: 100 megapixels are ordinary here (it still refuses twice its limit), EXIF is not used.

    Python's filters are shared by all threads, so another thread may be silenced too; hence only Pillow is named.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"PIL\.")
        yield


def _rgb(image: Image.Image, file: Path) -> NDArray[np.uint8]:
    if image.mode == "F":
        raise InputError(f"{file}: has floating-point pixels and is not a photo; remove it")
    if image.mode in DEEP_MODES:
        grey = (np.clip(np.asarray(image), 0, 65535) >> 8).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    return np.array(image.convert("RGB"))


def _carries_metadata(file: Path) -> bool:
    try:
        with _quiet_pillow(), Image.open(file) as image:
            exif = image.getexif()
            position = exif.get_ifd(ExifTags.IFD.GPSInfo)
            focal = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLength)
            xmp = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or exif.get(TIFF_XMP_TAG)
            return bool(position or focal or xmp)
    except (OSError, SyntaxError, ValueError):
        return False
