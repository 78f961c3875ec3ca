# SPDX-License-Identifier: Apache-2.0
"""The disk: the run directory with its cache and products, folders of photos, tables. No other module knows files."""

from skymoor.store._atomic import atomic_folder
from skymoor.store._cache import read_stage
from skymoor.store._closure import import_closure
from skymoor.store._digest import digest
from skymoor.store._photos import check_photos, has_metadata, name_prefix, open_photos
from skymoor.store._plain import plain
from skymoor.store._run import PRODUCTS, StageRecord, Store, is_run

__all__ = [
    "PRODUCTS",
    "StageRecord",
    "Store",
    "atomic_folder",
    "check_photos",
    "digest",
    "has_metadata",
    "import_closure",
    "is_run",
    "name_prefix",
    "open_photos",
    "plain",
    "read_stage",
]
