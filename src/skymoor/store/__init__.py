# SPDX-License-Identifier: Apache-2.0
"""The disk: the run directory with its cache and products, folders of photos, tables. No other module knows files."""

from skymoor.store._atomic import atomic_folder
from skymoor.store._digest import code_fingerprint, digest
from skymoor.store._photos import check_photos, has_metadata, name_prefix, open_photos, photos_fingerprint
from skymoor.store._run import PRODUCTS, StageRecord, Store, plain

__all__ = [
    "PRODUCTS",
    "StageRecord",
    "Store",
    "atomic_folder",
    "check_photos",
    "code_fingerprint",
    "digest",
    "has_metadata",
    "name_prefix",
    "open_photos",
    "photos_fingerprint",
    "plain",
]
