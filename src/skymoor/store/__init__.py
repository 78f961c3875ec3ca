# SPDX-License-Identifier: Apache-2.0
"""The disk: the run directory with its cache and products, folders of photos, tables. No other module knows files."""

from skymoor.store._atomic import atomic_file, atomic_files, atomic_folder
from skymoor.store._cache import STAGES, read_stage
from skymoor.store._closure import defining_modules, fingerprint, import_closure
from skymoor.store._digest import digest
from skymoor.store._kept import Kept
from skymoor.store._lock import LOCK
from skymoor.store._marks import FETCHED, FRAMES, PRODUCTS, is_run
from skymoor.store._plain import plain
from skymoor.store._run import FROM_CACHE, StageRecord, Store
from skymoor.store.photos import (
    FoundFiles,
    PhotoFile,
    VideoOptions,
    check_photos,
    count_frames,
    find_photos,
    has_metadata,
    name_prefix,
    open_image,
    open_photos,
    require_enough,
    video_ready,
)

__all__ = [
    "FETCHED",
    "FRAMES",
    "FROM_CACHE",
    "LOCK",
    "PRODUCTS",
    "STAGES",
    "FoundFiles",
    "Kept",
    "PhotoFile",
    "StageRecord",
    "Store",
    "VideoOptions",
    "atomic_file",
    "atomic_files",
    "atomic_folder",
    "check_photos",
    "count_frames",
    "defining_modules",
    "digest",
    "find_photos",
    "fingerprint",
    "has_metadata",
    "import_closure",
    "is_run",
    "name_prefix",
    "open_image",
    "open_photos",
    "plain",
    "read_stage",
    "require_enough",
    "video_ready",
]
