# SPDX-License-Identifier: Apache-2.0
"""The same flight given as photos, as a model, as a cloud and as an orthophoto: is it placed as well each time?

    python benchmarks/given_models.py --out WORK SITE [SITE ...] [--photos FOLDER] [--kinds colmap,cloud,...]

A site is a folder with site.toml, whose reference has files, and truth.csv. It is run once (or a finished run lies in
WORK/SITE/run); what that run made of the photos, in a frame of its own and without its position, is then given to
`skymoor register`. The error is the mean horizontal (and vertical) distance of the cameras to the truth: of clouds and
orthophotos, which have none, that of the run's cameras moved as the model was moved. A line of JSON for each. Resumes.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import skymoor
from skymoor.geometry import Similarity
from skymoor.results.formats import enu_from_map
from skymoor.results.read import Result
from skymoor.results.tables import read_truth_csv
from support.given_models import (
    LEVEL,
    TILTED,
    cloud_of,
    moved_colmap,
    turned_rasters,
    write_las,
    write_ply,
    write_raster,
)

Array = NDArray[np.float64]
Case = Callable[[Result, Path, Path], tuple[list[Path], Callable[[Result], Array] | None]]
"""Makes a model's files of a run; returns them, and what moves the run's cameras (n, 3 ENU) as a result moved them."""


def old_cameras(run: Result) -> Array:
    return np.array([[row.east, row.north, row.up] for row in run.registered_cameras], dtype=np.float64)


def carried(run: Result, new: Result, model_from_old: Similarity) -> Array:
    """Cameras of the run, ENU, as the model went that is `model_from_old` of the run's ENU."""
    found = new.components[0].enu_from_sfm
    assert found is not None
    return (found @ model_from_old).apply(old_cameras(run))


def colmap(run: Result, site: Path, work: Path) -> tuple[list[Path], None]:
    return [moved_colmap(run.folder, work / "colmap")], None


def cloud(run: Result, site: Path, work: Path, *, tilted: bool = False) -> tuple[list[Path], Callable[[Result], Array]]:
    points, colours = cloud_of(run.folder)
    with rasterio.open(run.folder / "dsm.tif") as dsm:
        enu = enu_from_map(points, run.frame, dsm.crs.to_wkt())
    move = TILTED if tilted else LEVEL
    name = "cloud.ply" if tilted else "cloud.las"
    write = write_ply if tilted else write_las
    return [write(work / name, move.apply(enu), colours)], lambda new: carried(run, new, move)


def tilted_cloud(run: Result, site: Path, work: Path) -> tuple[list[Path], Callable[[Result], Array]]:
    return cloud(run, site, work, tilted=True)


def orthophoto(run: Result, site: Path, work: Path, *, heights: bool = False) -> tuple[list[Path], Any]:
    bands, dsm, grid = turned_rasters(run.folder)
    files = [write_raster(work / "flight.tif", bands)]
    files += [write_raster(work / "flight_dsm.tif", dsm[None], nodata=-9999)] if heights else []

    def moved(new: Result) -> Array:
        """The run's cameras in plan, by where the corners of the orthophoto were and where they are."""
        (placed,) = (new.folder / "placed").glob("flight.tif")
        size = bands.shape[1:]
        px = np.array([[0, 0], [size[1], 0], [0, size[0]], [size[1], size[0]]], dtype=np.float64)
        with rasterio.open(placed) as now, rasterio.open(run.folder / "ortho.tif") as was:
            corners = [np.column_stack([*(transform @ px.T), np.zeros(4)]) for transform in (grid, now.transform)]
            old, then = (
                enu_from_map(c, run.frame, one.crs.to_wkt())[:, :2] for c, one in zip(corners, (was, now), strict=True)
            )
        plan, *_ = np.linalg.lstsq(np.column_stack([old, np.ones(4)]), then, rcond=None)
        cameras = old_cameras(run)
        return np.column_stack([np.column_stack([cameras[:, :2], np.ones(len(cameras))]) @ plan, cameras[:, 2]])

    return files, moved


def surface(run: Result, site: Path, work: Path) -> tuple[list[Path], Any]:
    return orthophoto(run, site, work, heights=True)


CASES: dict[str, Case] = {
    "colmap": colmap,
    "cloud": cloud,
    "tilted cloud": tilted_cloud,
    "orthophoto and DSM": surface,
    "orthophoto": orthophoto,
}


def errors(found: Array, run: Result, truth: Path) -> dict[str, float]:
    """Mean distances in plan and in height of positions (n, 3) ENU of the run's cameras to the truth."""
    true = {Path(row.image).name: row for row in read_truth_csv(truth)}
    names = [Path(row.image).name for row in run.registered_cameras]
    known = [k for k, name in enumerate(names) if name in true and run.registered_cameras[k].set == "airborne"]
    lla = [true[names[k]] for k in known]
    at = run.frame.enu_from_lla(*np.array([[one.lat, one.lon, one.height] for one in lla], dtype=np.float64).T)
    away = found[known] - at
    return {"plan_m": float(np.hypot(*away[:, :2].T).mean()), "height_m": float(np.abs(away[:, 2]).mean())}


def reference_of(site: Path) -> dict[str, Any]:
    table = tomllib.loads((site / "site.toml").read_text())["reference"]
    files = {key: site / table[key] if isinstance(table[key], str) else table[key] for key in ("ortho", "dsm")}
    stated = {key: table[key] for key in ("vertical_datum", "ce90", "le90") if key in table}
    return files | ({"accuracy": "unknown"} if "ce90" not in stated else {}) | stated  # it changes no position


def placed(run: Result, site: Path, kind: str, work: Path, photos: Path | None) -> dict[str, Any]:
    shutil.rmtree(work / "given", ignore_errors=True)  # of a broken run
    (work / "given").mkdir(parents=True)
    start, cpu = time.time(), time.process_time()
    files, moved = CASES[kind](run, site, work / "given")
    extra = {"photos": photos} if kind == "colmap" and photos is not None else {}
    new = skymoor.register_model(files, out=work / "out", **reference_of(site), **extra)
    part = new.components[0]
    line = {"site": site.name, "kind": kind, "status": part.summary["status"], "reason": part.reason}
    line |= {"cpu_s": time.process_time() - cpu, "wall_s": time.time() - start}
    if part.registered:
        own = {row.image.split("/")[-1]: row for row in new.registered_cameras}
        rows = [own.get(row.image.split("/")[-1]) for row in run.registered_cameras]
        none = [np.nan] * 3
        at = moved(new) if moved else np.array([none if r is None else [r.east, r.north, r.up] for r in rows], float)
        line |= errors(at, run, site / "truth.csv")
    return line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--photos", type=Path, help="photos of the COLMAP model; without it the tie points alone count")
    parser.add_argument("--kinds", default=",".join(CASES))
    options = parser.parse_args()
    for site in options.sites:
        work = options.out / site.name
        done = (work / "run" / "summary.json").is_file()
        run = skymoor.read(work / "run") if done else skymoor.register(site / "site.toml", out=work / "run")
        print(json.dumps({"site": site.name, "kind": "photos", **errors(old_cameras(run), run, site / "truth.csv")}))
        for kind in options.kinds.split(","):
            file = work / kind.replace(" ", "_") / "line.json"
            if not file.is_file():
                line = placed(run, site, kind, file.parent, options.photos)
                file.write_text(json.dumps(line))
            print(file.read_text(), flush=True)


if __name__ == "__main__":
    main()
