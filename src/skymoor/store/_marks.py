# SPDX-License-Identifier: Apache-2.0
"""What the folder of a run contains, and by what it is known."""

from __future__ import annotations

from pathlib import Path

from skymoor.errors import InputError
from skymoor.store._cache import STAGES
from skymoor.store._lock import LOCK

FRAMES = "frames"
"""Folder of the frames of videos in that of a run."""
FETCHED = "fetched"
"""Folder of a reference that was fetched for a run, in that of the run."""
PRODUCTS = (
    *(
        "summary.json",
        "cameras.csv",
        "cameras.geojson",
        "statistics.json",
        "control.csv",
        "colmap",
        "pointcloud.laz",
        "ortho.tif",
        "dsm.tif",
        "confidence.tif",
        "change.tif",
        "changes.geojson",
    ),
    *("renders", "matches", "evaluation.json", "report.html", "report.pdf", "run.log", "placed", "answers.json"),
    *(FETCHED, FRAMES, STAGES),
)
"""What skymoor writes into a run directory, or deletes from it."""
MARKS = (LOCK, "summary.json", STAGES)
"""By one of these a folder is known as a run directory."""


def is_run(folder: Path) -> bool:
    """Whether a folder has a trace of a run."""
    return any((folder / mark).exists() for mark in MARKS)


def holds_a_run(folder: Path) -> bool:
    """The same of any folder, where one mark alone could be of another program."""
    finished = (folder / "summary.json").is_file() and (folder / "cameras.csv").is_file()
    return finished or ((folder / STAGES).is_dir() and (folder / LOCK).exists())


def require_no_others_files(out: Path) -> None:
    """A folder without a trace of a run may hold an ortho.tif, but then it is not skymoor's to replace or delete."""
    if is_run(out):
        return
    for name in PRODUCTS:
        if (out / name).exists():
            raise InputError(
                f"{out / name}: is not of a run, and a run would replace it; give another folder with --out"
            )
