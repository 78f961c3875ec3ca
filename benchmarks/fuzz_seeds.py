# SPDX-License-Identifier: Apache-2.0
"""The seeds of `fuzz_readers.py`: small valid files of every kind that skymoor reads."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import fuzz_files as files
import fuzz_models as models

from skymoor.results.tables import read_camera_rows

LARGEST_STAGE = 2_000_000  # bytes
SEEDS: dict[str, Callable[[Path], None]] = {
    one.__name__: one
    for one in (
        *(files.site, files.tables, files.reference, files.vrt, files.world_file, files.photos, files.video),
        *(files.index, models.orthophoto, models.odm, models.colmap_binary, models.colmap_text, models.nerfstudio),
        *(models.opensfm, models.bundler, models.metashape, models.realityscan, models.ply, models.ply_mesh),
        *(models.ply_text, models.ply_splat, models.spz, models.obj, models.gltf, models.glb, models.las),
        *(models.laz, models.copc, models.e57),
    )
}


def run(folder: Path, of: Path) -> None:
    """The files of a finished run that are read again, with the truth, and its smaller stages."""
    names = ("*.json", "cameras.csv", "*.tif", "*.laz", "colmap/*/*", "matches/*.npz", "renders/*", "stages/*.npz")
    for path in (path for name in names for path in of.glob(name)):
        if path.is_file() and path.stat().st_size < LARGEST_STAGE:
            (folder / path.relative_to(of)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, folder / path.relative_to(of))
    rows = [row for row in read_camera_rows(of / "cameras.csv") if row.lat is not None]
    lines = ["image,lat,lon,height", *(f"{row.image},{row.lat},{row.lon},{row.height or 0}" for row in rows)]
    (folder / "truth.csv").write_text("\n".join(lines) + "\n")
    (folder / "answers.json").write_text('{"answers": [{"component": "airborne_0", "words": "x", "by": ""}]}')


def write_seeds(folder: Path, of_run: Path | None) -> None:
    """Each seed in a folder of its own, where it is not there yet."""
    for name, write in SEEDS.items():
        if not (folder / name).exists():
            (folder / name).mkdir(parents=True)
            write(folder / name)
    if of_run is not None and not (folder / "run").exists():
        (folder / "run").mkdir()
        run(folder / "run", of_run)
