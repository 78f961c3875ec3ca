# SPDX-License-Identifier: Apache-2.0
"""COLMAP's PatchMatch stereo, as in the paper; needs a build of COLMAP with GPU support.

Schoenberger, Zheng, Pollefeys and Frahm, Pixelwise View Selection for Unstructured Multi-View Stereo, ECCV 2016.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from skymoor.densify.consistency import confirmed
from skymoor.densify.neighbours import stereo_partners
from skymoor.densify.protocol import DepthEstimator
from skymoor.densify.views import reduced, undistorted
from skymoor.engines.colmap import colmap_from_component
from skymoor.engines.options import FIXED
from skymoor.engines.temporary import temporary_folder
from skymoor.errors import BackendUnavailable, InputError
from skymoor.types import Array32, Camera, Component, DepthMap, Image, Photos, Progress, no_progress

View = tuple[Camera, Image]


@dataclass(frozen=True)
class PatchMatchDepth:
    """PatchMatch stereo with geometric consistency, on a GPU.

    Attributes:
        colmap: path of the program `colmap`; empty for pycolmap where its build can use a GPU, and for the program on
            the PATH otherwise.
        max_px: long side of the depth maps.
        partners: stereo partners per photo.
        best_angle_deg, max_angle_deg: best and largest angle between viewing rays.
        min_views: other depth maps that must confirm a depth for it to count.
        tolerance_ratio: relative difference of depths that confirm each other.
        noise_px: standard deviation of a disparity.
    """

    colmap: str = ""
    max_px: int = 1600
    partners: int = field(default=8, metadata=FIXED)
    best_angle_deg: float = field(default=14.0, metadata=FIXED)
    max_angle_deg: float = field(default=35.0, metadata=FIXED)
    min_views: int = field(default=2, metadata=FIXED)
    tolerance_ratio: float = field(default=0.01, metadata=FIXED)
    noise_px: float = field(default=0.3, metadata=FIXED)

    def ready(self) -> tuple[Path, ...]:
        """No weights are read; see `__call__` for what is raised where no COLMAP can use a GPU."""
        self._engine()
        return ()

    def __call__(self, component: Component, photos: Photos, *, progress: Progress = no_progress) -> Iterator[DepthMap]:
        """Depth maps of all cameras that have partners; see `DepthEstimator`.

        Raises:
            BackendUnavailable: there is no build of COLMAP that can use a GPU, or it failed.
            InputError: there is no program at the given path.
        """
        engine = self._engine()
        partners = stereo_partners(
            component, count=self.partners, best_angle_deg=self.best_angle_deg, max_angle_deg=self.max_angle_deg
        )
        progress(0, len(component.cameras))
        with temporary_folder() as folder:
            views = [self._view(camera, photos) for camera in component.cameras]
            write_workspace(folder, component, views, partners)
            engine(folder, lambda done: progress(min(done, len(views)), len(views) + 1))
            depths = {k: _depth(folder, k, view) for k, view in enumerate(views) if partners[k]}
        for k in depths:
            depth_map = self._confirmed(k, views, depths, partners[k])
            if np.isfinite(depth_map.depth).any():
                yield depth_map
        progress(len(views), len(views))

    def _view(self, camera: Camera, photos: Photos) -> View:
        return undistorted(*reduced(camera, photos.read(camera.image), self.max_px))

    def _confirmed(self, k: int, views: list[View], depths: dict[int, Array32], partners: list[int]) -> DepthMap:
        camera, rgb = views[k]
        # Only maps of partners are compared.
        others = [(views[j][0], depths[j]) for j in partners if j in depths]
        sigma, n_views = confirmed(
            (camera, depths[k]), others, tolerance_ratio=self.tolerance_ratio, noise_px=self.noise_px
        )
        good = n_views >= min(self.min_views, max(len(others), 1))
        nan = np.float32(np.nan)
        return DepthMap(camera, np.where(good, depths[k], nan), np.where(good, sigma, nan), n_views, rgb)

    def _engine(self) -> Callable[[Path, Callable[[int], None]], None]:
        if not self.colmap and pycolmap.has_cuda:
            return lambda folder, _: pycolmap.patch_match_stereo(
                folder, options=pycolmap.PatchMatchOptions(max_image_size=self.max_px)
            )
        program = _program(self.colmap)
        return lambda folder, report: _run(program, folder, self.max_px, report)


_: type[DepthEstimator] = PatchMatchDepth


def read_colmap_depth(path: Path) -> Array32:
    """A depth map (h, w) as COLMAP writes it: its sizes, then rows of float32; 0 is no depth.

    Raises:
        InputError: the file is missing, truncated, or of another format.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such depth map; run COLMAP's patch_match_stereo first")
    content = path.read_bytes()
    try:
        *sizes, values = content.split(b"&", 3)
        width, height, channels = (int(size) for size in sizes)
    except ValueError:
        raise InputError(f"{path}: not a depth map of COLMAP; is it the right file?") from None
    if min(width, height) < 1 or channels != 1 or len(values) != 4 * width * height:
        raise InputError(
            f"{path}: truncated, or not a depth map of COLMAP ({width} x {height} x {channels}); compute it again"
        )
    return np.array(np.frombuffer(values, "<f4").reshape(height, width), np.float32)


def write_workspace(folder: Path, component: Component, views: list[View], partners: list[list[int]]) -> None:
    """Write the workspace of patch_match_stereo: undistorted photos and cameras, points, and stereo partners.

    Args:
        folder: an empty folder.
        component: points and their observations.
        views: per camera, without distortion.
        partners: per camera; one without is left out.
    """
    for part in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps", "stereo/consistency_graphs"):
        (folder / part).mkdir(parents=True)
    for k, (_, rgb) in enumerate(views):
        cv2.imwrite(str(folder / "images" / _name(k)), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    cameras = tuple(replace(camera, image=_name(k)) for k, (camera, _) in enumerate(views))
    px = np.zeros_like(component.obs_px)
    for k, camera in enumerate(cameras):
        own = component.obs_camera == k
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[own]])
        px[own] = np.nan_to_num(camera.intrinsics.px_from_cam(xyz_cam))
    colmap_from_component(replace(component, cameras=cameras, obs_px=px)).write(folder / "sparse")
    lines = [f"{_name(k)}\n{', '.join(_name(j) for j in chosen)}\n" for k, chosen in enumerate(partners) if chosen]
    (folder / "stereo/patch-match.cfg").write_text("".join(lines))


def _name(index: int) -> str:
    """File name of an uncompressed image: image libraries of OpenCV and COLMAP may conflict in one process."""
    return f"{index:06d}.ppm"


def _depth(folder: Path, index: int, view: View) -> Array32:
    path = folder / "stereo/depth_maps" / f"{_name(index)}.geometric.bin"
    depth = read_colmap_depth(path)
    i = view[0].intrinsics
    if depth.shape != (i.height, i.width):
        raise InputError(f"{path.name}: {depth.shape[1]} x {depth.shape[0]} depths for {i.width} x {i.height} pixels")
    return np.where(depth > 0, depth, np.float32(np.nan))


def _program(path: str) -> str:
    """Path of the program `colmap`, if its build can use a GPU."""
    program = shutil.which(path or "colmap")
    if program is None and path:
        raise InputError(f"{path}: there is no such program; give the path of colmap")
    if program is None:
        raise BackendUnavailable(
            "PatchMatch stereo needs a GPU: this pycolmap has no CUDA, and there is no program colmap; "
            "install COLMAP with CUDA, or use sgm"
        )
    help_text = subprocess.run([program, "help"], capture_output=True, text=True, check=False).stdout
    if "with CUDA" not in help_text and "with HIP" not in help_text and "with GPU" not in help_text:
        raise BackendUnavailable(f"{program}: a build of COLMAP that cannot use a GPU; install one with CUDA")
    return program


def _run(program: str, folder: Path, max_px: int, report: Callable[[int], None]) -> None:
    options = {"max_image_size": max_px, "geom_consistency": 1}
    flags = [word for name, value in options.items() for word in (f"--PatchMatchStereo.{name}", str(value))]
    log = folder / "log.txt"
    with log.open("w") as file:
        command = [program, "patch_match_stereo", "--workspace_path", str(folder), "--workspace_format", "COLMAP"]
        process = subprocess.Popen([*command, *flags], stdout=file, stderr=subprocess.STDOUT)
        try:
            while True:
                report(len(list((folder / "stereo/depth_maps").glob("*.geometric.bin"))))
                try:
                    status = process.wait(timeout=1.0)
                    break
                except subprocess.TimeoutExpired:
                    continue
        finally:
            process.kill()
    if status:
        last = (log.read_text(errors="replace").strip().splitlines() or ["no reason given"])[-1]
        raise BackendUnavailable(f"{program}: patch_match_stereo failed with status {status} ({last[:200]})")
