# SPDX-License-Identifier: Apache-2.0
"""What a run was made from: fingerprints of its inputs, versions, and the weights that it used."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skymoor.engines.libraries import version_of
from skymoor.engines.weights import files_in
from skymoor.store import Store, digest
from skymoor.types import Photos

LIBRARIES = ("numpy", "scipy", "pycolmap", "opencv-python-headless", "torch", "rasterio", "pyproj", "pillow")
LARGEST_HASHED_BYTES = 4e9  # half a minute of reading; beyond, size must do


def provenance(
    reference: tuple[Path, Path | float | None], photos: Mapping[str, Photos], weights: Sequence[Path], store: Store
) -> dict[str, Any]:
    """For the summary: who asks years later which files and programs made these positions finds it there.

    Args:
        reference: its orthophoto and elevation model, hashed whole; or one height in metres, or None.
        photos: by the name of the set; hashed over names and bytes.
        weights: files and folders that the run's engines have read.
        store: knows what files hold.
    """
    ortho, dsm = reference
    heights = _file(dsm, store) if isinstance(dsm, Path) else {"height_m": dsm}
    return {
        "reference": {"ortho": _file(ortho, store), "dsm": heights},
        "photos": {name: {"count": len(found), "sha256": digest(found.content)} for name, found in photos.items()},
        "weights": _weights(weights, store),
        "python": platform.python_version(),
        "platform": f"{sys.platform} {platform.machine()}",
        "libraries": {name: version_of(name) for name in LIBRARIES},
    }


def _weights(paths: Sequence[Path], store: Store) -> list[dict[str, Any]]:
    try:
        return [{"file": file.name} | _file(file, store) for file in files_in(paths)]
    except OSError:  # gone since the run read them
        return []


def _file(path: Path, store: Store) -> dict[str, Any]:
    try:
        size = path.stat().st_size
    except OSError:  # the run is done, and must not be lost because a file has gone meanwhile
        return {"bytes": None, "sha256": None}
    cheap = path.is_file() and size <= LARGEST_HASHED_BYTES
    return {"bytes": size, "sha256": store.files.sha256(path) if cheap else None}
