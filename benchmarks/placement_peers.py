# SPDX-License-Identifier: Apache-2.0
"""The place of a picture from above in a reference: ours beside matchers of images and of point clouds.

    OMP_NUM_THREADS=1 python benchmarks/placement_peers.py WORK --site RUN SITE.toml [--site ...] [--areas 0 1 4]
        [--windows 3] [--false 1] [--weights DIR...] [--kiss PYTHON]

Windows are cut from the nadir render of RUN, a finished run of the site, and turned and scaled at random; truth is
where the run has them. Area 0 is the site's own reference; others are mosaics of `large_areas.py`, in which the own
reference is hidden among pieces of the other sites. False windows are mirrored, and lie nowhere. What the others are
told: the scale, all but SIFT; ours and SIFT search a factor of ten. ALIKED gets four headings, and tiles of the
reference. A method is right within 3 m in the mean of the window's corners. It claims a place by `CLAIMS`. Rows are
appended to WORK/placement.jsonl; the same command goes on where it stopped. KISS-Matcher runs in the environment of
PYTHON.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from cloud_peers import fpfh_ransac, fpfh_target, kiss
from image_peers import PEERS, Peer
from large_areas import HEIGHTS_M, RATIO, TOLERANCE_PX, enu_of, write_mosaic
from paper_tables import print_table, provenance
from srif import limit_threads

from skymoor.match.features import nearest
from skymoor.match.propose import image_features
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.reference_pyramid import ReferencePyramid
from skymoor.match.search import SearchOptions, search_in
from skymoor.pipeline.feature_index import reference_features, write_index
from skymoor.pipeline.reference_files import ReferenceFiles
from skymoor.pipeline.search import Extent, places_of
from skymoor.pipeline.site import load_site
from skymoor.reference.read import read_reference
from skymoor.results.read import Result
from skymoor.types import Array, Raster, Reference, Render, View, no_progress

RIGHT_M = 3.0
SIDES_M = (60.0, 150.0)
SCALES = (0.5, 1.0)  # of the window's resolution
TILE_PX, OVERLAP_PX = 1024, 256
VOXEL_M = 2.0
CLAIMS = {"skymoor": 36.0, "SIFT": 15.0, "ALIKED n16rot": 15.0, "FPFH + RANSAC": 0.5, "KISS-Matcher": 5.0}
"""Least score of ours, 1.3 times the next; inliers of the others (COLMAP's least, KISS-Matcher's), or the fit share."""

Found = tuple[Array | None, float]  # (2, 3) ENU from pixels of the window, and how strong


@dataclass(frozen=True, eq=False)
class Case:
    """A turned and scaled window in metres, and its true place: (2, 3) ENU from its pixels."""

    render: Render
    truth: Array
    mirrored: bool

    @cached_property
    def image(self) -> Raster:
        """For matchers of images."""
        return nadir_raster(self.render, 0.2)

    @cached_property
    def cloud(self) -> Array:
        """Points (n, 3) in metres about the middle, x to the right and y up in the window."""
        return cloud_of(self.render.xyz[..., 2], self.render.view.pixel)

    def enu_from_cloud(self, matrix: Array) -> Array:
        """(2, 3) ENU from pixels, of a (4, 4) ENU from the cloud, at its mean height."""
        h, w = self.image.mask.shape
        px = np.array([[0.0, 0.0], [w, 0], [0, h]])
        local = np.column_stack([cloud_px(px, (h, w), self.render.view.pixel), np.full(3, self.cloud[:, 2].mean())])
        there = (local @ matrix[:3, :3].T + matrix[:3, 3])[:, :2]
        return np.column_stack([(there[1] - there[0]) / w, (there[2] - there[0]) / h, there[0]])


class Area:
    """A reference with what each method computes of it once."""

    def __init__(self, ortho: Path, dsm: Path, datum: str | None) -> None:
        write_index(ortho)
        self.files = (ortho, dsm, datum)
        self.reference: Reference = read_reference(ortho, dsm, datum, np.eye(3))
        self.features = reference_features(self.reference, ortho, write_index(ortho)[0])
        self.pyramid = ReferencePyramid(reference_raster(self.reference), self.features)

    @cached_property
    def cloud(self) -> Array:
        """Points (n, 3) ENU."""
        grid, heights = self.reference.grid, self.reference.height
        step = max(1, round(VOXEL_M / 2 / grid.pixel_m))
        points = np.concatenate([grid.centres(), heights[..., None]], axis=-1)[::step, ::step].reshape(-1, 3)
        return points[np.isfinite(points).all(axis=1)]

    @cached_property
    def fpfh(self) -> Any:
        """Features of the cloud."""
        return fpfh_target(self.cloud, VOXEL_M)

    def tiles(self) -> Iterator[tuple[Raster, int, int]]:
        """Overlapping parts, with their first pixel (u, v)."""
        h, w = self.reference.mask.shape
        step = TILE_PX - OVERLAP_PX
        for v in range(0, max(1, h - OVERLAP_PX), step):
            for u in range(0, max(1, w - OVERLAP_PX), step):
                part = np.s_[v : v + TILE_PX, u : u + TILE_PX]
                yield Raster(self.reference.rgb[part], self.reference.mask[part]), u, v


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--site", type=Path, nargs=2, action="append", required=True)
    parser.add_argument("--areas", type=float, nargs="*", default=[0.0, 1.0, 4.0], help="square kilometres")
    parser.add_argument("--windows", type=int, default=3, help="of each site and area")
    parser.add_argument("--false", type=int, default=1, help="mirrored ones, likewise")
    parser.add_argument("--weights", type=Path, nargs="*", default=[])
    parser.add_argument("--kiss", type=Path, help="Python of an environment with kiss-matcher")
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results/placement_peers.json"))
    options = parser.parse_args()
    limit_threads()
    options.work.mkdir(parents=True, exist_ok=True)
    log = options.work / "placement.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    done = {tuple(row["key"]) for row in rows}
    for area in options.areas:
        for k, (run, toml) in enumerate(options.site):
            others = [load_site(other).reference for j, (_, other) in enumerate(options.site) if j != k]
            for row in measured(options, area, run, toml, others, done):
                rows.append(row)
                print(row, flush=True)
                with log.open("a") as out:
                    out.write(json.dumps(row) + "\n")
    write(rows, options.results)


def measured(
    options: argparse.Namespace, area: float, run: Path, toml: Path, others: list[ReferenceFiles], done: set[Any]
) -> Iterator[dict[str, Any]]:
    """Rows of one site in one area that are not there yet."""
    name, methods = toml.parent.name, methods_of(options)
    keys = [(name, area, n, method) for n in range(options.windows + options.false) for method in methods]
    if all(key in done for key in keys):
        return
    files = load_site(toml).reference
    folder = options.work / f"{name}-{area:g}"
    if area and not (folder / "done").exists():
        write_mosaic(folder, files, others, area, np.random.default_rng(1))
    own = (options.work / f"{name}.tif", files.dsm)
    if not area and not own[0].exists():
        own[0].symlink_to(Path(files.ortho).resolve())  # the index lies beside it
    ortho, dsm = (folder / "ortho.tif", folder / "dsm.tif") if area else own
    target, rng = Area(ortho, dsm, files.vertical_datum), np.random.default_rng(7)
    for n in range(options.windows + options.false):
        case = case_of(Result.read(run), target.reference, rng, mirrored=n >= options.windows)
        for method, call in methods.items():
            if (key := (name, area, n, method)) not in done:
                start = time.process_time()
                found, strength, *other = call(case, target)
                seconds = other[0] if other else time.process_time() - start
                yield {"key": key, "mirrored": case.mirrored, "side_m": round(side_of(case))} | {
                    "error_m": None if found is None else round(corner_error(found, case), 2),
                    "strength": round(float(strength), 3),
                    "cpu_s": round(seconds, 2),
                    "claimed": bool(strength >= CLAIMS[method]),
                }


def methods_of(options: argparse.Namespace) -> dict[str, Callable[[Case, Area], Any]]:
    """By name; those that cannot run are left out, with a line."""
    found: dict[str, Callable[[Case, Area], Any]] = {"skymoor": ours, "SIFT": sift, "FPFH + RANSAC": fpfh}
    aliked = next(peer for peer in PEERS if peer.name == "ALIKED n16rot")
    if aliked.method(options.weights) is not None:
        found[aliked.name] = Tiled(aliked, options.weights)
    if options.kiss is not None:
        found["KISS-Matcher"] = lambda case, area: by_kiss(case, area, options.kiss)
    return found


def case_of(result: Result, reference: Reference, rng: np.random.Generator, *, mirrored: bool) -> Case:
    """A window of the run's nadir render, turned and scaled at random."""
    part = next(one for one in result.components if one.registered and one.image_set == "airborne")
    with np.load(result.folder / "renders" / f"{part.name}_nadir.npz") as kept:
        rgb, xyz, confidence = kept["rgb"], kept["xyz"], kept["confidence"]
    enu = enu_of(result, part.name, xyz)
    known = np.isfinite(xyz[..., 2])
    v, u = np.nonzero(known)
    # The plane through its pixels, in the frame of the reference.
    u, v = u[::37], v[::37]
    lla = result.frame.lla_from_enu(enu[v, u])
    plan = reference.frame.enu_from_lla(lla[:, 0], lla[:, 1], lla[:, 2])[:, :2]
    enu_from_px = np.linalg.lstsq(np.column_stack([u + 0.5, v + 0.5, np.ones_like(u)]), plan, rcond=None)[0].T
    pixel_m = float(np.sqrt(abs(np.linalg.det(enu_from_px[:, :2]))))
    for _ in range(100):
        side, angle, scale = rng.uniform(*SIDES_M), rng.uniform(0, 2 * np.pi), rng.uniform(*SCALES)
        size = int(side / pixel_m * scale)
        k = rng.integers(len(u))
        c, s = scale * np.cos(angle), scale * np.sin(angle)
        linear = np.array([[c, -s], [s, c]])
        window_from_px = np.column_stack([linear, size / 2 - linear @ [u[k], v[k]]])
        cut = cut_out(rgb, enu[..., 2], confidence, window_from_px, size, pixel_m / scale)
        if np.isfinite(cut.xyz[..., 2]).mean() > 0.8:
            break
    inverse = np.linalg.inv(linear)
    px_from_window = np.column_stack([inverse, -inverse @ window_from_px[:, 2]])
    truth = enu_from_px[:, :2] @ px_from_window + np.column_stack([np.zeros((2, 2)), enu_from_px[:, 2]])
    if mirrored:
        cut = replace(cut, rgb=cut.rgb[:, ::-1].copy(), xyz=cut.xyz[:, ::-1].copy(), confidence=cut.confidence[:, ::-1])
    return Case(cut, truth, mirrored)


def cut_out(rgb: Any, heights: Array, confidence: Any, matrix: Array, size: int, pixel_m: float) -> Render:
    """The layers resampled by `matrix` (2, 3), window from pixels, to a square of `size`."""
    in_opencv = matrix.copy()
    in_opencv[:, 2] += matrix[:, :2] @ [0.5, 0.5] - 0.5
    reduce = min(1.0, float(np.sqrt(np.linalg.det(matrix[:, :2]))))
    blurred = cv2.GaussianBlur(rgb, (0, 0), 0.5 / reduce) if reduce < 0.9 else rgb
    colours = cv2.warpAffine(blurred, in_opencv, (size, size), flags=cv2.INTER_LINEAR)
    layers = [
        cv2.warpAffine(x.astype(np.float32), in_opencv, (size, size), flags=cv2.INTER_NEAREST, borderValue=border)
        for x, border in ((heights, np.nan), (confidence, 0.0))
    ]
    local = np.zeros((size, size, 3), np.float32)
    local[..., 2] = layers[0] - np.nanmedian(heights)
    local[~np.isfinite(layers[0])] = np.nan
    return Render(View(np.diag([1.0, -1.0, -1.0]), 0.0, 0.0, pixel_m, (size, size)), colours, local, layers[1])


def ours(case: Case, area: Area) -> Found:
    low, high = Extent((HEIGHTS_M[0] / 63.0, HEIGHTS_M[1] / 63.0)).scales(case.render, area.reference)
    options = SearchOptions()
    found = search_in(area.pyramid, case.image, min_scale=low, max_scale=high, options=options, progress=no_progress)
    if not found:
        return None, 0.0
    place = places_of(found[:1], case.render, area.reference, area.files, 0.2, options)[0]
    matrix = place.hypothesis.matrix((case.image.mask.shape[0], case.image.mask.shape[1]))
    second = found[1].score if len(found) > 1 else 0.0
    return enu_of_px(matrix, place.reference), found[0].score if found[0].score >= 1.3 * second else 0.0


def sift(case: Case, area: Area) -> Found:
    """All features of the reference, found tile by tile; ratio test, RANSAC."""
    ratio = case.render.view.pixel / area.reference.grid.pixel_m / area.features.pixel
    own = image_features(case.image, ratio / 4, ratio * 4)
    index = nearest(own, area.features, 2)
    there = area.features.descriptors.astype(np.float32)
    first, second = (np.linalg.norm(own.descriptors.astype(np.float32) - there[index[:, k]], axis=1) for k in (0, 1))
    good = first < RATIO * second
    if good.sum() < 3:
        return None, 0.0
    limit = TOLERANCE_PX * area.features.pixel
    matrix, inliers = cv2.estimateAffinePartial2D(
        own.px[good], area.features.px[index[good, 0]], method=cv2.RANSAC, ransacReprojThreshold=limit, maxIters=20000
    )
    return (None, 0.0) if matrix is None else (enu_of_px(matrix, area.reference), float(inliers.sum()))


class Tiled:
    """A matcher of images, on tiles of the reference, with the window reduced to its pixel: the scale is given."""

    def __init__(self, peer: Peer, weights: list[Path]) -> None:
        self._method = peer.method(weights)

    def __call__(self, case: Case, area: Area) -> Found:
        assert self._method is not None
        zoom = min(1.0, case.render.view.pixel / area.reference.grid.pixel_m)
        h, w = (max(1, round(n * zoom)) for n in case.image.mask.shape)
        rgb = np.asarray(cv2.resize(case.image.rgb, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
        mask = cv2.resize(case.image.mask.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST) > 0
        best, most = None, 0.0
        for tile, u, v in area.tiles():
            found = self._method(Raster(rgb, mask), tile)
            if found.b_from_a is not None and found.inliers > most:
                moved = found.b_from_a * [w / case.image.mask.shape[1], h / case.image.mask.shape[0], 1]
                best, most = moved + [[0, 0, u], [0, 0, v]], float(found.inliers)
        return (None, 0.0) if best is None else (enu_of_px(best, area.reference), most)


def fpfh(case: Case, area: Area) -> Found:
    matrix, fitness = fpfh_ransac(case.cloud, area.fpfh, VOXEL_M)
    return case.enu_from_cloud(matrix), fitness


def by_kiss(case: Case, area: Area, python: Path) -> tuple[Array, float, float]:
    matrix, inliers, seconds = kiss(case.cloud, area.cloud, VOXEL_M, python)
    return case.enu_from_cloud(matrix), inliers, seconds


def cloud_of(heights: Array, pixel_m: float) -> Array:
    step = max(1, round(VOXEL_M / 2 / pixel_m))
    rows, columns = np.nonzero(np.isfinite(heights[::step, ::step]))
    px = np.column_stack([columns, rows]) * step + 0.5
    return np.column_stack([cloud_px(px, heights.shape, pixel_m), heights[rows * step, columns * step]])


def cloud_px(px: Array, shape: tuple[int, ...], pixel_m: float) -> Array:
    return (px - [shape[1] / 2, shape[0] / 2]) * [pixel_m, -pixel_m]


def enu_of_px(matrix: Array, reference: Reference) -> Array:
    """(2, 3) ENU from pixels of the window, of reference pixels from those."""
    grid = reference.grid
    flip = np.diag([grid.pixel_m, -grid.pixel_m])
    return flip @ matrix + np.array([[0, 0, grid.east0], [0, 0, grid.north0]])


def corner_error(found: Array, case: Case) -> float:
    """Mean distance, in metres, of the window's corners from their true places."""
    h, w = case.image.mask.shape
    corners = np.array([[0, 0, 1], [w, 0, 1], [0, h, 1], [w, h, 1]], np.float64)
    return float(np.linalg.norm(corners @ (found - case.truth).T, axis=1).mean())


def side_of(case: Case) -> float:
    return float(case.render.view.pixel * case.image.mask.shape[1])


def write(rows: list[dict[str, Any]], results: Path) -> None:
    """The table as Markdown, and the file of results."""
    table = []
    for area in sorted({row["key"][1] for row in rows}):
        for method in CLAIMS:
            own = [row for row in rows if row["key"][1] == area and row["key"][3] == method]
            true, false = ([row for row in own if row["mirrored"] == side] for side in (False, True))
            if not own:
                continue
            right = [row["error_m"] for row in true if row["error_m"] is not None and row["error_m"] <= RIGHT_M]
            claimed = [row for row in true if row["claimed"]]
            wrong = [row for row in claimed if row["error_m"] is None or row["error_m"] > RIGHT_M]
            table.append(
                [
                    area or "own",
                    method,
                    f"{len(right)} of {len(true)}",
                    round(float(np.median(right)), 2) if right else "-",
                ]
                + [f"{len(claimed) - len(wrong)} right, {len(wrong)} wrong"]
                + [f"{sum(row['claimed'] for row in false)} of {len(false)}"]
                + [round(float(np.median([row["cpu_s"] for row in own])), 1)]
            )
    print_table(
        ("km2", "method", "found within 3 m", "median m of those", "claimed", "mirrored claimed", "CPU s"), table
    )
    results.parent.mkdir(parents=True, exist_ok=True)
    results.write_text(json.dumps({**provenance(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
