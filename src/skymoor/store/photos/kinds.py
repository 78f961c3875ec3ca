# SPDX-License-Identifier: Apache-2.0
"""Kinds of files by their endings: what is read, and what cannot be, with the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PIL import features

AVIF = bool(features.check("avif"))
"""Pillow reads AVIF from 11.3, where it is built with libavif."""
SUFFIXES = (
    *(".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".heic", ".heif", ".mpo"),
    *((".avif",) if AVIF else ()),
)
VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".mpg", ".mpeg", ".wmv", ".3gp")


@dataclass(frozen=True)
class UnreadableKind:
    """Files that a user takes for photos, and what makes them readable."""

    name: str
    suffixes: tuple[str, ...]
    remedy: str


_RAW = (
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".raf", ".orf", ".rw2", ".pef", ".srw"),
    *(".x3f", ".3fr", ".fff", ".iiq", ".erf", ".kdc", ".dcr", ".mrw", ".rwl", ".gpr", ".raw"),
)
# Their decoders read what no camera writes, or would need libraries that few have.
UNREADABLE = (
    UnreadableKind("raw photo", _RAW, "develop to JPEG or TIFF, all with the same settings and without lens profiles"),
    UnreadableKind("JPEG 2000 image", (".jp2", ".j2k", ".jpf", ".jpx"), "convert to JPEG or PNG"),
    UnreadableKind("JPEG XL image", (".jxl",), "convert to JPEG or PNG"),
    *(() if AVIF else (UnreadableKind("AVIF image", (".avif",), "convert to JPEG, or install pillow 11.3 or newer"),)),
    UnreadableKind("Photoshop file", (".psd", ".psb"), "convert to JPEG or PNG"),
    UnreadableKind("recording of a 360 degree camera", (".insp", ".insv", ".360"), "export flat photos from it"),
)


def is_photo(path: Path) -> bool:
    """By its ending."""
    return path.suffix.lower() in SUFFIXES


def is_video(path: Path) -> bool:
    """By its ending."""
    return path.suffix.lower() in VIDEOS


def unreadable_kind(path: Path) -> UnreadableKind | None:
    """What a file is that cannot be read, None for one that is no image or can be."""
    return next((kind for kind in UNREADABLE if path.suffix.lower() in kind.suffixes), None)
