# SPDX-License-Identifier: Apache-2.0
"""Hits, time and memory of the search over the area of the reference, beside SIFT with a ratio test and RANSAC.

    python benchmarks/large_areas.py WORK --site RUN SITE.toml [--site ...] --others ORTHO DSM [--others ...]
        [--areas 1 4 16] [--windows 10] [--mirrored 2]

The reference of each site is hidden, at its own coordinates, in a mosaic of mirrored and turned pieces of the other
sites and of `--others`, with an index beside it. RUN is a finished run of the site: windows of 80 to 300 m are cut from
its nadir render, and their true place is where the run has them. Mirrored windows match nowhere. Rows are appended to
WORK/large_areas.jsonl; the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.transform import from_origin

from skymoor.geo import Grid
from skymoor.match.decoys import mirrored
from skymoor.match.features import Features, nearest
from skymoor.match.propose import image_features
from skymoor.match.rasters import nadir_raster
from skymoor.match.reference_pyramid import ReferencePyramid
from skymoor.match.search import SearchOptions, search_in
from skymoor.pipeline.feature_index import reference_features, write_index
from skymoor.pipeline.reference_files import ReferenceFiles
from skymoor.pipeline.search import Extent, places_of
from skymoor.pipeline.site import load_site
from skymoor.reference.read import read_reference
from skymoor.results.read import Result
from skymoor.types import Array, Raster, Reference, Render, View, no_progress

HEIGHTS_M = (20.0, 200.0)
SIDES_M = (80.0, 300.0)
RATIO = 0.8  # Lowe's test, on distances
TOLERANCE_PX = 3.0
HIT_M = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--site", type=Path, nargs=2, action="append", required=True)
    parser.add_argument("--others", type=Path, nargs=2, action="append", default=[])
    parser.add_argument("--areas", type=float, nargs="*", default=[1.0, 4.0, 16.0], help="square kilometres")
    parser.add_argument("--windows", type=int, default=10, help="of each site")
    parser.add_argument("--mirrored", type=int, default=2, help="of each site")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    log = options.work / "large_areas.jsonl"
    done = {tuple(json.loads(line)["key"]) for line in log.read_text().splitlines()} if log.exists() else set()
    for area in options.areas:
        for k, (run, toml) in enumerate(options.site):
            others = [pair for j, pair in enumerate(options.site) if j != k]
            pieces = [load_site(other).reference for _, other in others]
            pieces += [ReferenceFiles(ortho, dsm, "ellipsoid", np.eye(3)) for ortho, dsm in options.others]
            keys = [(toml.parent.name, area, n) for n in range(options.windows + options.mirrored)]
            if all(key in done for key in keys):
                continue
            with log.open("a") as out:
                for key, row in measured(options.work, run, toml, pieces, area, options):
                    if key not in done:
                        out.write(json.dumps({"key": key, **row}) + "\n")
                        out.flush()
                        print(key, row, flush=True)


def measured(
    work: Path, run: Path, toml: Path, pieces: list[ReferenceFiles], area: float, options: argparse.Namespace
) -> Iterator[tuple[tuple[str, float, int], dict[str, object]]]:
    """Rows of one site in a mosaic of one area."""
    files, folder = load_site(toml).reference, work / f"{toml.parent.name}-{area:g}"
    seconds: dict[str, float] = {}
    if not (folder / "done").exists():
        write_mosaic(folder, files, pieces, area, np.random.default_rng(1))
    ortho, dsm = folder / "ortho.tif", folder / "dsm.tif"
    start = time.process_time()
    index, count = write_index(ortho)
    seconds["index_s"] = time.process_time() - start
    start = time.process_time()
    reference = read_reference(ortho, dsm, files.vertical_datum, np.eye(3))
    seconds["read_s"] = time.process_time() - start
    start = time.process_time()
    features = reference_features(reference, ortho, index)
    seconds["features_s"] = time.process_time() - start
    pyramid = ReferencePyramid(
        Raster(reference.rgb, reference.mask, reference.height / reference.grid.pixel_m), features
    )
    rng = np.random.default_rng(7)
    for n in range(options.windows + options.mirrored):
        window, truth = window_of(Result.read(run), reference, rng)
        decoy = n >= options.windows
        image = nadir_raster(window, 0.2)
        row = searched(
            mirrored(image) if decoy else image, window, pyramid, reference, (ortho, dsm, files.vertical_datum)
        )
        off = np.hypot(*(np.array(row["place_m"]) - truth))
        baseline = sift_ransac(mirrored(image) if decoy else image, window, reference, features)
        row |= {"decoy": decoy, "side_m": float(max(window.view.shape) * window.view.pixel), "off_m": float(off)}
        row |= {"sift_s": baseline[1], "sift_inliers": baseline[2]}
        row["sift_off_m"] = None if baseline[0] is None else float(np.hypot(*(baseline[0] - truth)))
        row |= {"features": count, "pixel_m": reference.grid.pixel_m, **seconds}
        row["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        yield (toml.parent.name, area, n), row


def window_of(result: Result, reference: Reference, rng: np.random.Generator) -> tuple[Render, Array]:
    """A square window of the run's nadir render, in metres, and where its middle is in the frame of `reference`."""
    part = next(one for one in result.components if one.registered and one.image_set == "airborne")
    with np.load(result.folder / "renders" / f"{part.name}_nadir.npz") as kept:
        rgb, xyz, confidence = kept["rgb"], kept["xyz"], kept["confidence"]
    enu = enu_of(result, part.name, xyz)
    pixel_m = float(np.nanmedian(np.linalg.norm(np.diff(enu[..., :2], axis=1), axis=-1)))
    known = np.isfinite(xyz[..., 2])
    rows, columns = np.nonzero(known)
    for _ in range(200):
        side = min(int(rng.uniform(*SIDES_M) / pixel_m), *known.shape)
        k = rng.integers(len(rows))
        top = int(np.clip(rows[k] - side // 2, 0, known.shape[0] - side))
        left = int(np.clip(columns[k] - side // 2, 0, known.shape[1] - side))
        part_of = np.s_[top : top + side, left : left + side]
        if known[part_of].mean() > 0.6:
            break
    middle = enu[part_of][known[part_of]].mean(axis=0)
    # The window's own middle, by the plane through its pixels.
    v, u = np.nonzero(known[part_of])
    design = np.column_stack([u + 0.5, v + 0.5, np.ones_like(u)])
    plane = np.linalg.lstsq(design, enu[part_of][known[part_of]][:, :2], rcond=None)[0]
    plan = np.array([side / 2, side / 2, 1.0]) @ plane
    lat, lon, _ = result.frame.lla_from_enu([[*plan, middle[2]]])[0]
    truth = reference.frame.enu_from_lla([lat], [lon], [reference.frame.height_m])[0, :2]
    view = View(np.diag([1.0, -1.0, -1.0]), 0.0, 0.0, pixel_m, (side, side))
    heights = enu[part_of][..., 2:] - np.nanmedian(enu[part_of][..., 2])
    local = np.concatenate([np.zeros((side, side, 2)), heights], axis=-1)
    local[~known[part_of]] = np.nan
    return Render(view, rgb[part_of], local.astype(np.float32), confidence[part_of]), truth


def enu_of(result: Result, name: str, xyz: Array) -> Array:
    """Positions in the run's ENU frame of the level frame's, by its inliers."""
    with np.load(result.folder / "matches" / f"{name}.npz") as kept:
        level, plan = kept["xyz_level"][kept["inliers"]], kept["xyz_enu"][kept["inliers"]][:, :2]
    x, y = (points[:, 0] + 1j * points[:, 1] for points in (level, plan))
    factor, shift = np.linalg.lstsq(np.column_stack([x, np.ones_like(x)]), y, rcond=None)[0]
    moved = factor * (xyz[..., 0] + 1j * xyz[..., 1]) + shift
    return np.stack([moved.real, moved.imag, abs(factor) * xyz[..., 2]], axis=-1)


def searched(
    image: Raster,
    window: Render,
    pyramid: ReferencePyramid,
    reference: Reference,
    files: tuple[Path, Path, str | None],
) -> dict[str, object]:
    start = time.process_time()
    # The window is in metres, so that scales are ratios: those of 20 to 200 m of flying height for one of 63 m.
    low, high = Extent((HEIGHTS_M[0] / 63.0, HEIGHTS_M[1] / 63.0)).scales(window, reference)
    found = search_in(pyramid, image, min_scale=low, max_scale=high, options=SearchOptions(), progress=no_progress)
    if not found:
        return {"score": 0.0, "next": 0.0, "by_features": False, "search_s": 0.0, "place_m": [np.inf, np.inf]}
    place = places_of(found[:1], replace(window, rgb=image.rgb), reference, files, 0.2, SearchOptions())[0]
    seconds = time.process_time() - start
    east, north = place.reference.grid.enu_from_px(place.hypothesis.centre_px).tolist()
    second = found[1].score if len(found) > 1 else 0.0
    return {
        "score": found[0].score,
        "next": second,
        "by_features": found[0].by_features,
        "search_s": seconds,
        "place_m": [east, north],
    }


def sift_ransac(
    image: Raster, window: Render, reference: Reference, features: Features
) -> tuple[Array | None, float, int]:
    """Position of the image's middle by SIFT, ratio test and RANSAC on all matches; seconds; inliers."""
    start = time.process_time()
    ratio = window.view.pixel / reference.grid.pixel_m / features.pixel
    own = image_features(image, ratio / 4, ratio * 4)
    index = nearest(own, features, 2)
    first, second = (
        np.linalg.norm(
            own.descriptors.astype(np.float32) - features.descriptors[index[:, k]].astype(np.float32), axis=1
        )
        for k in (0, 1)
    )
    good = first < RATIO * second
    matrix, inliers = None, None
    if good.sum() >= 3:
        a, b = own.px[good], features.px[index[good, 0]]
        limit = TOLERANCE_PX * features.pixel
        matrix, inliers = cv2.estimateAffinePartial2D(
            a, b, method=cv2.RANSAC, ransacReprojThreshold=limit, maxIters=20000, confidence=0.999
        )
    seconds = time.process_time() - start
    if matrix is None or inliers is None:
        return None, seconds, 0
    middle = matrix @ [image.mask.shape[1] / 2, image.mask.shape[0] / 2, 1.0]
    return reference.grid.enu_from_px(middle), seconds, int(inliers.sum())


def write_mosaic(
    folder: Path, files: ReferenceFiles, pieces: list[ReferenceFiles], area: float, rng: np.random.Generator
) -> None:
    """ortho.tif and dsm.tif of an area, in a local CRS about the site; memory-mapped, as they are large."""
    own = read_reference(files.ortho, files.dsm, files.vertical_datum, np.eye(3))
    pixel_m = own.grid.pixel_m
    others = [read_reference(one.ortho, one.dsm, one.vertical_datum, np.eye(3), pixel_m=pixel_m) for one in pieces]
    side = round(1000 * np.sqrt(area) / pixel_m)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    rgb = np.memmap(folder / "rgb.raw", np.uint8, "w+", shape=(side, side, 3))
    height = np.memmap(folder / "height.raw", np.float32, "w+", shape=(side, side))
    height[:] = np.nan

    def put(piece: Reference, v: int, u: int, turns: int | None) -> tuple[int, int]:
        layers = [piece.rgb, piece.height - np.nanmedian(piece.height)]
        if turns is not None:
            layers = [np.rot90(x[:, ::-1] if turns % 2 else x, turns // 2) for x in layers]
        h, w = min(layers[1].shape[0], side - v), min(layers[1].shape[1], side - u)
        rgb[v : v + h, u : u + w], height[v : v + h, u : u + w] = layers[0][:h, :w], layers[1][:h, :w]
        return layers[1].shape

    v = 0
    while v < side:
        u, tallest = 0, 0
        while u < side:
            h, w = put(others[rng.integers(len(others))], v, u, int(rng.integers(8)))
            u, tallest = u + w, max(tallest, h)
        v += max(tallest - 20, 100)
    corner = [int(rng.integers(side - n - 1)) for n in own.mask.shape]
    put(own, corner[0], corner[1], None)
    frame = own.frame
    crs = f"+proj=tmerc +k=1 +lat_0={frame.lat_deg} +lon_0={frame.lon_deg} +datum=WGS84 +units=m"
    origin = Grid(own.grid.east0 - corner[1] * pixel_m, own.grid.north0 + corner[0] * pixel_m, pixel_m, (side, side))
    profile = {
        "driver": "GTiff",
        "height": side,
        "width": side,
        "crs": crs,
        "transform": from_origin(origin.east0, origin.north0, pixel_m, pixel_m),
        "tiled": True,
        "compress": "deflate",
    }
    with rasterio.open(folder / "ortho.tif", "w", count=3, dtype="uint8", **profile) as out:
        for _, block in out.block_windows(1):
            out.write(rgb[block.toslices()].transpose(2, 0, 1), window=block)
    with rasterio.open(folder / "dsm.tif", "w", count=1, dtype="float32", nodata=np.nan, **profile) as out:
        for _, block in out.block_windows(1):
            out.write(height[block.toslices()][None] + frame.height_m, window=block)
    for name in ("rgb.raw", "height.raw"):
        (folder / name).unlink()
    (folder / "done").touch()


if __name__ == "__main__":
    main()
