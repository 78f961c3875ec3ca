# SPDX-License-Identifier: Apache-2.0
"""What this machine has for a run, and the remedy for what it lacks."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from skymoor import __version__
from skymoor.engines.libraries import version_of
from skymoor.engines.weights import KNOWN, weights_folder
from skymoor.errors import BackendUnavailable
from skymoor.results.report.pdf import WITHOUT_BROWSER, browser

LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "pycolmap", "rasterio", "pyproj", "laspy", "rich")
OPTIONAL = {
    "torch": "nerf",
    "kornia": "kornia",
    "romatch": "roma",
    "transformers": "segmentation",
    "diffusers": "depth",
    "huggingface-hub": "hub",
    "viser": "view",
    "plotly": "plot",
    "pandas": "table",
    "trimesh": "models",
    "pyarrow": "export",
    "av": "video",
    "distributed": "dask",
}
LEAST_FREE_GB, LEAST_MEMORY_GB = 5.0, 4.0


@dataclass(frozen=True)
class Check:
    """One thing that was checked. `remedy` is empty where all is well; without `needed` it is only a hint."""

    name: str
    found: str
    remedy: str = ""
    needed: bool = True

    @property
    def status(self) -> str:
        """ "ok", "missing", or "optional" for what only some engines want."""
        return "ok" if not self.remedy else "missing" if self.needed else "optional"


def examine(folder: Path) -> list[Check]:
    """Check all that a run with results in `folder` may need. Downloads nothing, and raises nothing."""
    return [
        Check("skymoor", __version__),
        Check("python", f"{platform.python_version()} on {platform.platform()}"),
        *(_library(name) for name in LIBRARIES),
        *(_optional(name, extra) for name, extra in OPTIONAL.items()),
        *_processors(),
        *_memory(),
        *_disks(folder),
        *_weights(),
        _browser(),
    ]


def _library(name: str) -> Check:
    version = version_of(name)
    return Check(
        name, version or "-", "" if version else "install skymoor again: pip install --force-reinstall skymoor"
    )


def _optional(name: str, extra: str) -> Check:
    version = version_of(name)
    return Check(name, version or "-", "" if version else f'pip install "skymoor[{extra}]"', needed=False)


def _processors() -> Iterator[Check]:
    yield Check("cores", str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()))
    try:
        if version_of("torch"):
            import torch

            gpus = [torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count())]
            yield _gpu("GPU for networks", ", ".join(gpus), "PyTorch sees no CUDA device: networks run on the CPU")
        import pycolmap

        colmap = "yes" if pycolmap.has_cuda else ""
        yield _gpu("GPU for COLMAP", colmap, "PatchMatch stereo needs COLMAP with CUDA; the default stereo does not")
    except (ImportError, OSError, RuntimeError) as error:
        yield Check("GPU", "-", f"a library cannot be loaded: {error}")


def _gpu(name: str, found: str, hint: str) -> Check:
    return Check(name, found or "-", "" if found else hint, needed=False)


def _memory() -> Iterator[Check]:
    try:
        gigabytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (AttributeError, ValueError, OSError):  # not on every system
        return
    remedy = "" if gigabytes >= LEAST_MEMORY_GB else f"small runs take 2 GB, {LEAST_MEMORY_GB:.0f} GB are comfortable"
    yield Check("memory", f"{gigabytes:.1f} GB", remedy)


def _disks(folder: Path) -> Iterator[Check]:
    there = next(path for path in (folder.resolve(), *folder.resolve().parents) if path.exists())
    for name, path in (("disk for results", there), ("disk for temporary files", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(path).free / 1e9
        where = "another --out" if path == there else "another folder in TMPDIR"
        remedy = "" if free >= LEAST_FREE_GB else f"a run may want {LEAST_FREE_GB:.0f} GB: make room, or give {where}"
        yield Check(name, f"{free:.1f} GB free in {path}", remedy)
        if not os.access(path, os.W_OK):
            yield Check(name, f"{path} cannot be written", f"give {where}")


def _browser() -> Check:
    try:
        return Check("browser for report.pdf", browser())
    except BackendUnavailable:
        return Check("browser for report.pdf", "-", WITHOUT_BROWSER, needed=False)


def _weights() -> Iterator[Check]:
    root = weights_folder()
    here = [one.name for one in KNOWN if all(one.here(root))]
    hint = "none is needed; skymoor weights list shows them, skymoor weights fetch NAME downloads one"
    yield Check(f"weights in {root}", ", ".join(here) or "-", "" if here else hint, needed=False)
