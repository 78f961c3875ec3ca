# SPDX-License-Identifier: Apache-2.0
"""What a run was made from: fingerprints of its inputs, versions, and the weights that it used."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from skymoor.errors import SkymoorError
from skymoor.settings import Options, check_engines
from skymoor.store import digest, photos_fingerprint
from skymoor.weights import sha256_of

LIBRARIES = ("numpy", "scipy", "pycolmap", "opencv-python-headless", "torch", "rasterio", "pyproj", "pillow")
LARGEST_HASHED_BYTES = 4e9  # half a minute of reading; beyond, size must do


def provenance(ortho: Path, dsm: Path, folders: Mapping[str, Path], options: Options) -> dict[str, Any]:
    """For the summary: who asks years later which files and which programs made these positions finds it there.

    Args:
        ortho, dsm: the reference's files, hashed whole.
        folders: of photos, by the name of their set; their fingerprint is over names and bytes.
        options: of the run, which say the weights.
    """
    return {
        "reference": {"ortho": _file(ortho), "dsm": _file(dsm)},
        "photos": {name: _photos(folder) for name, folder in folders.items()},
        "weights": _weights(options, ground=len(folders) > 1),
        "python": platform.python_version(),
        "platform": f"{sys.platform} {platform.machine()}",
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _weights(options: Options, *, ground: bool) -> list[dict[str, Any]]:
    try:
        paths = check_engines(options, ground=ground)
        files = [file for path in paths for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
    except (SkymoorError, OSError):  # gone since the run read them
        return []
    return [{"file": file.name} | _file(file) for file in files if file.is_file()]


def _file(path: Path) -> dict[str, Any]:
    try:
        size = path.stat().st_size
        cheap = path.is_file() and size <= LARGEST_HASHED_BYTES
        return {"bytes": size, "sha256": sha256_of(path) if cheap else None}
    except OSError:  # the run is done, and must not be lost because a file has gone meanwhile
        return {"bytes": None, "sha256": None}


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


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:
        return None
