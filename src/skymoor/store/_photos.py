# SPDX-License-Identifier: Apache-2.0
"""Folders of photos: found, checked and read as raw 8-bit RGB."""

from __future__ import annotations

import unicodedata
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
# By content, whatever the name ends with; the other decoders of Pillow read things that no camera writes, and one
# starts a program to do so. JPEG takes its relative MPO along.
FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP")
FEWEST_PHOTOS = 3
# Two are decoded at a time, at 4 bytes per pixel in Pillow's hands and 10 while one is handed on: docs/limits.md.
LARGEST_MPX = 170
SMALLEST_SIDE_PX = 32
# Feature extraction scales photos down; a thinner strip would have no pixel left across.
LONGEST_RATIO = 20
DEEP_MODES = ("I", "I;16", "I;16L", "I;16B", "I;16N")
TIFF_XMP_TAG = 700


def open_photos(folder: Path, root: Path, progress: Progress = no_progress) -> Photos:
    """The photos directly in `folder`, by name; every one is decoded once as a check.

    Names are relative to `root` with forward slashes; for a folder outside of `root` they are FOLDER/FILE. Photos
    are read as they are stored: the EXIF orientation is ignored on purpose, since what counts is the sensor's raster.
    Grey and 16-bit images become 8-bit RGB, the latter by dropping the lower byte. Of several images in one file
    the first counts.

    Raises `InputError` for a missing or empty folder, for fewer than 3 photos, and for one that cannot be decoded to
    its end, is too large, too small or too long, or has a name that is not text.
    """
    return photos_from_sizes(folder, root, check_photos(folder, progress))


def check_photos(folder: Path, progress: Progress = no_progress) -> tuple[tuple[int, int], ...]:
    """Decode every photo with two threads; sizes (width, height) in the order of the names. Errors as `open_photos`."""
    files = photo_files(folder)
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


def photos_from_sizes(folder: Path, root: Path, sizes: Sequence[tuple[int, int]], content: object = None) -> Photos:
    """Photos of a folder that `check_photos` has passed. Raises `InputError` if there are more or fewer by now.

    `content` stands for all their pixels in the keys of stages.
    """
    files = photo_files(folder)
    if len(files) != len(sizes):
        raise InputError(f"{folder}: photos came or went while they were read; start again when all are there")
    prefix = name_prefix(folder, root)
    names = tuple((prefix / file.name).as_posix() for file in files)
    return Photos(names, tuple(sizes), _Reader(tuple(zip(names, files, strict=True))), content)


def name_prefix(folder: Path, root: Path) -> Path:
    """What the names of a folder's photos begin with, see `open_photos`."""
    inside, root = folder.resolve(), root.resolve()
    return inside.relative_to(root) if inside.is_relative_to(root) else Path(inside.name)


def has_metadata(folder: Path) -> int:
    """How many photos carry an EXIF position or focal length, or XMP. Only the headers are read."""
    return sum(_carries_metadata(file) for file in photo_files(folder))


@dataclass(frozen=True)
class _Reader:
    """Reads a photo by name; a class, because unlike a closure it can go to another process."""

    files: tuple[tuple[str, Path], ...]

    def __call__(self, name: str) -> NDArray[np.uint8]:
        return _decoded(dict(self.files)[name])


def photo_files(folder: Path) -> list[Path]:
    """The files of the photos directly in a folder, by name; see `open_photos` for what is raised."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder of images")
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from error
    named = [entry for entry in entries if entry.suffix.lower() in SUFFIXES and not entry.name.startswith(".")]
    files = [entry for entry in named if _is_photo_file(entry)]
    if not files:
        kinds = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise InputError(f"{folder}: has no images ({kinds}); sub-folders are not searched")
    if len(files) < FEWEST_PHOTOS:
        raise InputError(f"{folder}: has {len(files)} images, at least {FEWEST_PHOTOS} are needed")
    return files


def _is_photo_file(entry: Path) -> bool:
    """Folders and devices are passed over; a file that is meant to be a photo and cannot be used is reported."""
    if entry.is_symlink() and not entry.exists():
        raise InputError(f"{entry}: is a link to nothing; remove it, or put the photo where it points")
    if not entry.is_file():
        return False
    # Tables and COLMAP models hold names as text in UTF-8, on one line.
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in entry.name):
        raise InputError(f"{str(entry)!r}: its name is not readable text; rename it")
    return True


def _checked_size(file: Path) -> tuple[int, int]:
    with _opened(file) as image:
        width, height = image.size
    return width, height


def _decoded(file: Path) -> NDArray[np.uint8]:
    """(h, w, 3) RGB."""
    with _opened(file) as image:
        return _rgb(image)


@contextmanager
def _opened(file: Path) -> Iterator[Image.Image]:
    """A photo, decoded to its end. Pillow, unlike OpenCV, reports a file that ends too early."""
    try:
        with _quiet_pillow(), Image.open(file, formats=FORMATS) as image:
            _require_photo(image, file)
            image.load()
            yield image
    except InputError:
        raise
    except (Image.DecompressionBombError, MemoryError) as error:
        raise InputError(f"{file}: is too large; scale it down to {LARGEST_MPX} megapixels: {error}") from error
    except UnidentifiedImageError as error:
        raise InputError(
            f"{file}: is not an image that can be read ({', '.join(FORMATS)} with 8 bits per channel); remove it, "
            "copy it again or convert it"
        ) from error
    except (FileNotFoundError, PermissionError) as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}; put it back, or let it be read") from error
    except Exception as error:  # a decoder may stumble over a damaged file in any way
        raise InputError(f"{file}: is damaged ({error}); remove it or copy it again") from error


def _require_photo(image: Image.Image, file: Path) -> None:
    """From the header alone, before anything is decoded."""
    if image.mode == "F":
        raise InputError(f"{file}: has floating-point pixels and is not a photo; remove it")
    width, height = image.size
    if width * height > LARGEST_MPX * 1_000_000:
        raise InputError(
            f"{file}: is {width} by {height} pixels and too large; scale it down to {LARGEST_MPX} megapixels"
        )
    if min(width, height) < SMALLEST_SIDE_PX:
        raise InputError(
            f"{file}: is only {width} by {height} pixels; remove it, a side of {SMALLEST_SIDE_PX} is the least"
        )
    if max(width, height) > LONGEST_RATIO * min(width, height):
        raise InputError(
            f"{file}: is {width} by {height} pixels, which no camera takes at once; remove it, or cut it to "
            f"{LONGEST_RATIO} times its width"
        )


@contextmanager
def _quiet_pillow() -> Iterator[None]:
    """No warnings of Pillow: 100 megapixels are ordinary here (it still refuses twice its limit), EXIF is not used.

    Python's filters are shared by all threads, so another thread may be silenced too; hence only Pillow is named.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"PIL\.")
        yield


def _rgb(image: Image.Image) -> NDArray[np.uint8]:
    if image.mode in DEEP_MODES:
        grey = (np.clip(np.asarray(image), 0, 65535) >> 8).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    return np.array(image if image.mode == "RGB" else image.convert("RGB"))


def _carries_metadata(file: Path) -> bool:
    try:
        with _quiet_pillow(), Image.open(file, formats=FORMATS) as image:
            exif = image.getexif()
            position = exif.get_ifd(ExifTags.IFD.GPSInfo)
            focal = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLength)
            xmp = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or exif.get(TIFF_XMP_TAG)
            return bool(position or focal or xmp)
    except Exception:  # metadata that nobody can read is none, and it is not used anyway
        return False
