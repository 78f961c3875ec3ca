# SPDX-License-Identifier: Apache-2.0
"""One photo: checked from its header, decoded to its end, and handed on as 8-bit RGB."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

from skymoor.errors import InputError
from skymoor.store.photos.files import PhotoFile
from skymoor.store.photos.kinds import AVIF

# By content, whatever the name ends with; the other decoders of Pillow read things that no camera writes, and one
# starts a program to do so. JPEG takes its relative MPO along. HEIF is the plugin of pillow-heif.
FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP", "HEIF", *(("AVIF",) if AVIF else ()))
# Two are decoded at a time, at 4 bytes per pixel in Pillow's hands and 10 while one is handed on: docs/limits.md.
LARGEST_MPX = 170
SMALLEST_SIDE_PX = 32
# Feature extraction scales photos down; a thinner strip would have no pixel left across.
LONGEST_RATIO = 20
DEEP_MODES = ("I", "I;16", "I;16L", "I;16B", "I;16N")
TIFF_XMP_TAG = 700
TIFF_DNG_VERSION_TAG = 50706


def size_of(file: Path) -> tuple[int, int]:
    """(width, height) of a photo that can be decoded to its end. Raises `InputError` for any other."""
    with _opened(file) as image:
        width, height = image.size
    return width, height


def decoded(file: Path) -> NDArray[np.uint8]:
    """(h, w, 3) RGB. Grey and 16-bit images become 8-bit RGB, the latter by dropping the lower byte."""
    with _opened(file) as image:
        return _rgb(image)


def has_metadata(files: Sequence[PhotoFile]) -> int:
    """How many photos carry an EXIF position or focal length, or XMP. Only the headers are read."""
    return sum(_carries_metadata(file.path) for file in files)


def require_size(width: int, height: int, file: Path) -> None:
    """Raises `InputError` for what no camera takes, or is too large, before anything is decoded."""
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
def _opened(file: Path) -> Iterator[Image.Image]:
    """A photo, decoded to its end. Pillow, unlike OpenCV, reports a file that ends too early."""
    try:
        with _QUIET_PILLOW, open_image(file) as image:
            _require_photo(image, file)
            stated = image.size
            image.load()
            if image.size != stated:  # HEIC has a size in its header and one in its stream
                raise ValueError(f"the header says {stated}, the pixels {image.size}")
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


def open_image(file: Path) -> Image.Image:
    """A photo's header, by Pillow and without its checks; errors are those of Pillow."""
    _with_heif()
    return Image.open(file, formats=FORMATS)


@cache
def _with_heif() -> None:
    """Let Pillow read HEIC, with nothing but the photo itself: no thumbnails, depth or auxiliary images.

    Its decoder applies the rotation and mirroring of the file's own structure, unlike EXIF orientation, since without
    them the file has no defined raster; docs/limits.md.
    """
    import pillow_heif

    pillow_heif.register_heif_opener(thumbnails=False, depth_images=False, aux_images=False)


def _require_photo(image: Image.Image, file: Path) -> None:
    """From the header alone, before anything is decoded."""
    if image.mode == "F":
        raise InputError(f"{file}: has floating-point pixels and is not a photo; remove it")
    if TIFF_DNG_VERSION_TAG in (getattr(image, "tag_v2", None) or ()):
        # What TIFF readers see of it is a thumbnail.
        raise InputError(f"{file}: is a raw photo (DNG), whatever its name; develop it to JPEG or TIFF")
    require_size(*image.size, file)


class _QuietPillow:
    """No warnings of Pillow: 100 megapixels are ordinary here (it still refuses twice its limit), EXIF is not used.

    Python's filters are shared by all threads: the first one in sets them, and the last one out restores what was
    before, or one would take them away from under another. Who is silenced too is named: Pillow alone.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._filters = Lock(), 0, warnings.catch_warnings()

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                self._filters = warnings.catch_warnings()
                self._filters.__enter__()
                warnings.filterwarnings("ignore", module=r"(PIL|pillow_heif)\.")

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._filters.__exit__(None, None, None)


_QUIET_PILLOW = _QuietPillow()


def _rgb(image: Image.Image) -> NDArray[np.uint8]:
    if image.mode in DEEP_MODES:
        grey = (np.clip(np.asarray(image), 0, 65535) >> 8).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    return np.array(image if image.mode == "RGB" else image.convert("RGB"))


def _carries_metadata(file: Path) -> bool:
    try:
        with _QUIET_PILLOW, open_image(file) as image:
            exif = image.getexif()
            position = exif.get_ifd(ExifTags.IFD.GPSInfo)
            focal = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLength)
            xmp = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or exif.get(TIFF_XMP_TAG)
            return bool(position or focal or xmp)
    except Exception:  # metadata that nobody can read is none, and it is not used anyway
        return False
