# SPDX-License-Identifier: Apache-2.0
"""CPU time, memory and disk of every stage over the number of photos, and the errors of the cameras.

    python benchmarks/many_photos.py WORK [--photos 50 100 200 400] [--width 480] [--features 800] [--depth-px 320]
        [--results FILE.json]

Photos of smooth, textured hills are drawn with exact truth, as a flight for mapping takes them: the area grows with
their number, and the overlap stays. Each number of photos is measured in a process of its own with one thread. Rows
are kept in WORK; the same command goes on where it stopped, and another WORK belongs to other sizes.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from skymoor.densify import SgmDepth, check_camera_poses
from skymoor.geometry import Intrinsics, Similarity, umeyama
from skymoor.model import render_nadir
from skymoor.model.mesh import MeshBuilder
from skymoor.reconstruct import ReconstructOptions, SiftMatcher, reconstruct
from skymoor.simulate.capture.grid import grid_poses
from skymoor.store import Store, find_photos
from skymoor.store._memory import peak_mib, reset_peak
from skymoor.types import Array, Array32, Camera, Component, Image, Photos, Progress

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
HEIGHT_M, TILT_DEG = 80.0, 15.0
RELIEF_M, HILL_M = 6.0, 40.0  # standard deviation and size of the hills
MARGIN_M = 160.0


@dataclass(frozen=True)
class Hills:
    """Smooth random hills with a random texture, and the cameras that photograph them."""

    count: int
    width: int

    @cached_property
    def cameras(self) -> list[Camera]:
        size = (self.width, self.width * 3 // 4)
        focal = 0.875 * self.width
        lens = Intrinsics(*size, focal, focal, size[0] / 2, size[1] / 2, (-0.045, 0.012, 0.0, 0.0))
        poses = grid_poses(np.random.default_rng(1), lens, self.count, np.zeros(3), 1e6, TILT_DEG)
        return [Camera(f"{k:05d}.jpg", lens, pose) for k, pose in enumerate(poses)]

    @cached_property
    def corner(self) -> Array:
        """South-west corner of the drawn ground, metres."""
        return np.min([camera.centre[:2] for camera in self.cameras], axis=0) - MARGIN_M

    @cached_property
    def pixel_m(self) -> float:
        return HEIGHT_M / (0.875 * self.width)

    @cached_property
    def texture(self) -> Image:
        rng = np.random.default_rng(2)
        extent = np.ptp([camera.centre[:2] for camera in self.cameras], axis=0) + 2 * MARGIN_M
        shape = tuple(np.ceil(extent[::-1] / self.pixel_m).astype(int))
        grey = np.full(shape, 120.0, np.float32)
        for octave in range(7):
            noise = rng.normal(size=[-(-side // 2**octave) for side in shape]).astype(np.float32)
            grey += 14 * cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_CUBIC)
        return np.clip(grey, 0, 255).astype(np.uint8)

    @cached_property
    def heights(self) -> Array32:
        """Metres, one each 4 m."""
        rng = np.random.default_rng(3)
        shape = np.ceil(np.array(self.texture.shape) * self.pixel_m / 4).astype(int) + 1
        rough = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), HILL_M / 4)
        return np.asarray(rough * RELIEF_M / rough.std(), np.float32)

    def photo(self, camera: Camera) -> Image:
        i = camera.intrinsics
        px = np.stack(np.meshgrid(np.arange(i.width), np.arange(i.height)), axis=-1).reshape(-1, 2) + 0.5
        rays = i.rays(px) @ camera.cam_from_world.rotation
        plan = np.zeros((len(rays), 2))
        height = np.zeros(len(rays))
        for _ in range(8):  # towards the point of the ray at the ground's height
            plan = camera.centre[:2] + rays[:, :2] * ((height - camera.centre[2]) / rays[:, 2])[:, None]
            height = _sampled(self.heights, (plan - self.corner) / 4, i)
        grey = _sampled(self.texture, (plan - self.corner) / self.pixel_m, i)
        noisy = grey + np.random.default_rng(int(camera.image[:5])).normal(scale=2.0, size=len(grey))
        shape = (i.height, i.width, 1)
        return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8).reshape(shape), 3, axis=2)


def _sampled(raster: Image | Array32, px: Array, lens: Intrinsics) -> Array:
    columns, rows = (px[:, k].reshape(lens.height, lens.width).astype(np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(raster, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), float).ravel()


@dataclass
class Meter:
    """CPU seconds and peak memory by stage, and the largest size of the folder for temporary files."""

    temporary: Path
    rows: dict[str, dict[str, float]] = field(default_factory=dict)
    largest: int = 0

    def start(self) -> None:
        reset_peak()
        self._begin = time.process_time()

    def stop(self, stage: str) -> None:
        self.rows[stage] = {"cpu_s": round(time.process_time() - self._begin, 1), "peak_mib": round(peak_mib())}
        print(stage, self.rows[stage], flush=True)
        self.start()

    def watch(self) -> None:
        def sample() -> None:
            while True:
                self.largest = max(self.largest, bytes_under(self.temporary))
                time.sleep(0.3)

        threading.Thread(target=sample, daemon=True).start()


@dataclass(frozen=True)
class MeteredMatcher:
    """The default matcher, with the costs of its parts."""

    meter: Meter
    features: int

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        def report(done: int, total: int, note: str = "") -> None:
            if done == len(photos) and "features" not in self.meter.rows:
                self.meter.stop("features")
            progress(done, total, note)

        SiftMatcher(max_features=self.features)(photos, database, folder, seed=seed, progress=report)
        self.meter.stop("matching")
        self.meter.rows["database"] = {"mib": round(database.stat().st_size / 2**20)}


def measured(work: Path, count: int, options: argparse.Namespace) -> dict[str, object]:
    """The costs of all stages with this number of photos."""
    cv2.setNumThreads(1)
    os.cpu_count = lambda: 1  # what COLMAP's and our own threads are counted by
    hills, folder = Hills(count, options.width), work / f"photos-{count}"
    folder.mkdir(parents=True, exist_ok=True)
    for camera in hills.cameras:
        if not (folder / camera.image).exists():
            cv2.imwrite(str(folder / camera.image), hills.photo(camera))
    meter = Meter(Path(tempfile.gettempdir()))
    meter.watch()
    with Store.open(work / f"run-{count}") as store:
        photos = store.photos("photos", find_photos([folder], folder))
        meter.start()
        components = reconstruct(photos, ReconstructOptions(MeteredMatcher(meter, options.features)), seed=0)
        meter.stop("mapping")
        component = components[0]
        level = component.transformed(Similarity(1.0, enu_from_sfm(component, hills.cameras).rotation, np.zeros(3)))
        meter.start()
        depths = store.parts("depths", SgmDepth(max_px=options.depth_px), level, photos)
        meter.stop("dense")
        store.stage("pose_checks", check_camera_poses, level.cameras, depths, photos)
        meter.stop("pose checks")
        model = store.stage("model", MeshBuilder(), level, depths)
        meter.stop("mesh")
        store.stage("nadir", render_nadir, model)
        meter.stop("nadir view")
        disk = {file.name.split("-")[0]: file.stat().st_size for file in (store.root / "stages").glob("*.npz")}
    return {
        "photos": count,
        "components": [len(one.cameras) for one in components],
        "camera_error_m": camera_error_m(component, hills.cameras),
        "stages": meter.rows,
        "temporary_mib": round(meter.largest / 2**20),
        "disk_mib": {name: round(size / 2**20, 1) for name, size in disk.items()},
    }


def enu_from_sfm(component: Component, cameras: list[Camera]) -> Similarity:
    truth = {camera.image: camera.centre for camera in cameras}
    return umeyama(component.centres, np.array([truth[camera.image] for camera in component.cameras]))


def camera_error_m(component: Component, cameras: list[Camera]) -> float:
    """Root mean square of the centres' errors after a similarity, metres."""
    truth = {camera.image: camera.centre for camera in cameras}
    there = np.array([truth[camera.image] for camera in component.cameras])
    errors = enu_from_sfm(component, cameras).apply(component.centres) - there
    return round(float(np.sqrt((errors**2).sum(axis=1).mean())), 4)


def bytes_under(folder: Path) -> int:
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size
        except OSError:  # it is gone
            continue
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--photos", type=int, nargs="+", default=[50, 100, 200, 400])
    parser.add_argument("--width", type=int, default=480, help="of the photos, pixels")
    parser.add_argument("--features", type=int, default=800, help="of a photo")
    parser.add_argument("--depth-px", type=int, default=320, help="long side of the depth maps")
    parser.add_argument("--results", type=Path, help="also write all rows to this file")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    if options.one:
        (count,) = options.photos
        row = measured(options.work, count, options)
        (options.work / f"row-{count}.json").write_text(json.dumps(row))
        return
    for count in options.photos:
        if not (options.work / f"row-{count}.json").exists():
            measure_apart(options, count)
    rows = [json.loads((options.work / f"row-{count}.json").read_text()) for count in options.photos]
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    about = {"date": f"{date.today()}", "commit": commit.stdout.strip(), "machine": machine()}
    sizes = {name: getattr(options, name) for name in ("width", "features", "depth_px")}
    text = json.dumps({**about, **sizes, "rows": rows}, indent=1) + "\n"
    print(text)
    if options.results:
        options.results.write_text(text)


def measure_apart(options: argparse.Namespace, count: int) -> None:
    """In a process of its own, whose temporary files lie in a folder of their own."""
    sizes = [f"--width={options.width}", f"--features={options.features}", f"--depth-px={options.depth_px}"]
    command = [sys.executable, __file__, str(options.work), f"--photos={count}", *sizes, "--one"]
    with tempfile.TemporaryDirectory(dir=options.work) as temporary:
        subprocess.run(command, check=True, env={**os.environ, **ONE_THREAD, "TMPDIR": temporary})


def machine() -> str:
    return f"{platform.machine()}, {os.cpu_count()} cores"


if __name__ == "__main__":
    main()
