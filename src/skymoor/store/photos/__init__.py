# SPDX-License-Identifier: Apache-2.0
"""Photos and videos of a user: found in folders and their sub-folders, checked, and read as raw 8-bit RGB."""

from skymoor.store.photos.decode import has_metadata, open_image
from skymoor.store.photos.files import FoundFiles, PhotoFile, find_photos, name_prefix, require_enough
from skymoor.store.photos.keyframes import VideoOptions
from skymoor.store.photos.open import check_photos, open_photos, photos_of
from skymoor.store.photos.video import count_frames, video_ready, write_frames

__all__ = [
    "FoundFiles",
    "PhotoFile",
    "VideoOptions",
    "check_photos",
    "count_frames",
    "find_photos",
    "has_metadata",
    "name_prefix",
    "open_image",
    "open_photos",
    "photos_of",
    "require_enough",
    "video_ready",
    "write_frames",
]
