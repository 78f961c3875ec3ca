# SPDX-License-Identifier: Apache-2.0
"""When photos were taken."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from PIL import ExifTags

from skymoor.errors import InputError
from skymoor.results.formats._source import Source
from skymoor.store.photos.decode import open_image
from skymoor.types import Camera


def photo_times(source: Source, cameras: Sequence[Camera]) -> list[float] | None:
    """Seconds since 1970 at which photos were taken, by their clock; None where not all have distinct ones."""
    found = []
    for camera in cameras:
        try:
            with open_image(source.result.photo(camera.image)) as photo:
                tags = photo.getexif().get_ifd(ExifTags.IFD.Exif)
            taken = datetime.strptime(str(tags[ExifTags.Base.DateTimeOriginal]).strip("\0 "), "%Y:%m:%d %H:%M:%S")
            part = str(tags.get(ExifTags.Base.SubsecTimeOriginal, "0")).strip("\0 ")
            found.append(taken.replace(tzinfo=UTC).timestamp() + float(f"0.{part or 0}"))
        except (InputError, OSError, KeyError, ValueError):
            return None
    return found if len(set(found)) == len(found) else None
