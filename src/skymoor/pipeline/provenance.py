# SPDX-License-Identifier: Apache-2.0
"""What a run was made from: fingerprints of its inputs, versions, and the weights that it used."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from skymoor.engines.libraries import version_of
from skymoor.engines.weights import files_in, sha256_of, stamps
from skymoor.store import Store, digest, photos_fingerprint

LIBRARIES = ("numpy", "scipy", "pycolmap", "opencv-python-headless", "torch", "rasterio", "pyproj", "pillow")
LARGEST_HASHED_BYTES = 4e9  # half a minute of reading; beyond, size must do


def provenance(
    reference: tuple[Path, Path], photos: Mapping[str, tuple[Path, str]], weights: Sequence[Path], store: Store
) -> dict[str, Any]:
    """For the summary: who asks years later which files and programs made these positions finds it there.

    Stages of the run in `store`, so that a file is read for it once, and again when it has changed.

    Args:
        reference: its orthophoto and elevation model, hashed whole.
        photos: folder, and stage that has read it, by the name of the set; hashed over names and bytes.
        weights: files and folders that the run's engines have read.
    """
    stage = partial(store.stage, code=[__name__])
    ortho, dsm = reference
    return {
        "reference": stage(
            "reference.provenance", lambda: {"ortho": _file(ortho), "dsm": _file(dsm)}, after=["reference"]
        ),
        "photos": {
            name: stage(f"{name}.provenance", partial(_photos, folder), options=folder, after=[read_by])
            for name, (folder, read_by) in photos.items()
        },
        "weights": stage("weights.provenance", lambda: _weights(weights), options=stamps(weights)),
        "python": platform.python_version(),
        "platform": f"{sys.platform} {platform.machine()}",
        "libraries": {name: version_of(name) for name in LIBRARIES},
    }


def _photos(folder: Path) -> dict[str, Any]:
    """Number, and sha256 over the names and bytes of all photos in the order of their names."""
    whole, count = hashlib.sha256(), 0
    try:
        for name, size, _ in photos_fingerprint(folder):
            whole.update(digest((name, size, sha256_of(folder / name))).encode())
            count += 1
    except OSError:
        return {"count": None, "sha256": None}
    return {"count": count, "sha256": whole.hexdigest()}


def _weights(paths: Sequence[Path]) -> list[dict[str, Any]]:
    try:
        return [{"file": file.name} | _file(file) for file in files_in(paths)]
    except OSError:  # gone since the run read them
        return []


def _file(path: Path) -> dict[str, Any]:
    try:
        size = path.stat().st_size
        cheap = path.is_file() and size <= LARGEST_HASHED_BYTES
        return {"bytes": size, "sha256": sha256_of(path) if cheap else None}
    except OSError:  # the run is done, and must not be lost because a file has gone meanwhile
        return {"bytes": None, "sha256": None}
