# SPDX-License-Identifier: Apache-2.0
"""The offline default: semi-global matching (Hirschmueller 2008, OpenCV) on rectified neighbours, fused per photo.

Rectification rotates both cameras about their centres so that rows are epipolar lines (Fusiello, Trucco, Verri 2000);
lens distortion is removed in the same resampling.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from skymoor.densify.fuse import fuse_depths
from skymoor.densify.neighbours import depth_range, stereo_partners
from skymoor.densify.protocol import DepthEstimator
from skymoor.densify.views import reduced, undistorted
from skymoor.engines.options import FIXED
from skymoor.geometry import Intrinsics
from skymoor.types import Array, Array32, Camera, Component, DepthMap, Image, Mask, Photos, Progress, no_progress

Views = Callable[[int], tuple[Camera, Image]]

MAX_DISPARITIES = 320
MAX_STRETCH = 3.0
WIDEST_DEG = 65.0  # between a ray and the axis of the rectified view
GRID, FEWEST = 9, 9  # points of an image per side, and those that must be within that angle


@dataclass(frozen=True)
class SgmDepth:
    """Semi-global matching at `max_px` on the long side, with up to `partners` neighbours per photo.

    Attributes:
        max_px: long side of the depth maps.
        partners: stereo partners per photo.
        best_angle_deg, max_angle_deg: best and largest angle between viewing rays.
        min_views: partners that must agree for a depth to count.
        noise_grey: standard deviation of the image noise, in grey levels; sets the precision of textured surfaces.
    """

    max_px: int = 800
    partners: int = field(default=4, metadata=FIXED)
    best_angle_deg: float = field(default=14.0, metadata=FIXED)
    max_angle_deg: float = field(default=35.0, metadata=FIXED)
    min_views: int = field(default=2, metadata=FIXED)
    noise_grey: float = field(default=3.0, metadata=FIXED)

    def __call__(self, component: Component, photos: Photos, *, progress: Progress = no_progress) -> Iterator[DepthMap]:
        """Depth maps of all cameras that have partners; see `DepthEstimator`."""
        partners = stereo_partners(
            component, count=self.partners, best_angle_deg=self.best_angle_deg, max_angle_deg=self.max_angle_deg
        )

        @lru_cache(maxsize=64)
        def view(index: int) -> tuple[Camera, Image]:
            return reduced(component.cameras[index], photos.read(component.cameras[index].image), self.max_px)

        def depth_map_of(index: int) -> DepthMap | None:
            return self._depth_map(component, index, partners[index], view) if partners[index] else None

        # OpenCV's threads do not scale on one pair; whole photos in parallel do.
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            for done, depth_map in enumerate(pool.map(depth_map_of, range(len(component.cameras)))):
                if depth_map is not None and np.isfinite(depth_map.depth).any():
                    yield depth_map
                progress(done + 1, len(component.cameras))

    def _depth_map(self, component: Component, index: int, partners: list[int], view: Views) -> DepthMap:
        camera, image = view(index)
        near, far = depth_range(component, index)
        depths, sigmas = [], []
        for partner in partners:
            other, other_image = view(partner)
            depth, sigma = pair_depth(camera, image, other, other_image, near, far, self.noise_grey)
            depths.append(depth)
            sigmas.append(sigma)
        depth, sigma, n_views = fuse_depths(np.stack(depths), np.stack(sigmas), min_views=self.min_views)
        pinhole, rgb = undistorted(camera, image)
        return DepthMap(pinhole, depth, sigma, n_views, rgb)


_: type[DepthEstimator] = SgmDepth


def pair_depth(
    camera: Camera, image: Image, other: Camera, other_image: Image, near: float, far: float, noise_grey: float
) -> tuple[Array32, Array32]:
    """z-depth and its standard deviation for each pixel of the undistorted `camera`, from one partner.

    NaN where the match is not mutual or the pixel is outside. `near`, `far` bound the z-depth in `camera`.
    """
    rect = _rectify(camera, other, near, far)
    if rect is None:
        unknown = np.full((camera.intrinsics.height, camera.intrinsics.width), np.nan, np.float32)
        return unknown, unknown
    left, inside = _warp(image, camera, rect, rect.cx)
    right, _ = _warp(other_image, other, rect, rect.cx + rect.d_min)
    disparity = _match(left, right, rect.n_disparities)
    disparity[~inside] = np.nan
    sigma_d = _disparity_sigma(left, noise_grey)
    return _to_camera(disparity, sigma_d, camera, rect)


@dataclass(frozen=True, eq=False)
class _Rectified:
    rotation: Array  # rect_from_world
    focal: float
    cx: float
    cy: float
    size: tuple[int, int]
    baseline: float
    d_min: float
    n_disparities: int


def _rectify(camera: Camera, other: Camera, near: float, far: float) -> _Rectified | None:
    """A common image plane for two cameras; None where they cannot be rectified."""
    step = other.centre - camera.centre
    baseline = float(np.linalg.norm(step))
    x = step / baseline
    forward = camera.cam_from_world.rotation[2] + other.cam_from_world.rotation[2]
    z = forward - (forward @ x) * x
    if np.linalg.norm(z) < 0.5:  # the baseline is along the viewing direction
        return None
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    i = camera.intrinsics
    over_image = np.stack(np.meshgrid(*(np.linspace(0, side, GRID) for side in (i.width, i.height))), axis=-1)
    rays = i.rays(over_image.reshape(-1, 2)) @ camera.cam_from_world.rotation @ rotation.T
    # Of a camera that looks along the way, the part beside it is matched.
    rays = rays[_before(rays)]
    if len(rays) < FEWEST:
        return None
    # The rectified z at both ends of the depth range, anywhere in the image.
    ends = np.concatenate([rays[:, 2] * near, rays[:, 2] * far])
    span = baseline / ends.min() - baseline / ends.max()  # of the disparity, per pixel of focal length
    flat = rays[:, :2] / rays[:, 2:]
    low, high = flat.min(axis=0), flat.max(axis=0)
    # A large depth range, or an image stretched by rectification, is searched at a coarser scale.
    area = float(np.prod(high - low))
    focal = min(i.fx, MAX_DISPARITIES / span, np.sqrt(MAX_STRETCH * i.width * i.height / area))
    count = int(np.ceil((focal * span + 2) / 16) * 16)
    size = (int(focal * (high[0] - low[0])) + 1, int(focal * (high[1] - low[1])) + 1)
    d_min = np.floor(focal * baseline / ends.max())
    return _Rectified(rotation, focal, -focal * low[0], -focal * low[1], size, baseline, d_min, count)


def _before(rays: Array) -> Mask:
    """Whether rays (..., 3) are within `WIDEST_DEG` of the rectified view, beyond which it has no resolution."""
    return np.asarray(rays[..., 2] > np.cos(np.radians(WIDEST_DEG)) * np.linalg.norm(rays, axis=-1))


def _warp(image: Image, camera: Camera, rect: _Rectified, cx: float) -> tuple[Image, Mask]:
    """Resample an image into the rectified frame; also a mask of pixels inside the photo."""
    matrix = np.array([[rect.focal, 0, cx - 0.5], [0, rect.focal, rect.cy - 0.5], [0, 0, 1]])
    rect_from_cam = rect.rotation @ camera.cam_from_world.rotation.T
    map_x, map_y = cv2.initUndistortRectifyMap(
        camera.intrinsics.matrix_cv(),
        np.array(camera.intrinsics.distortion),
        rect_from_cam,
        matrix,
        rect.size,
        cv2.CV_32FC1,
    )
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    inside = (map_x > 0) & (map_y > 0) & (map_x < image.shape[1] - 1) & (map_y < image.shape[0] - 1)
    return cv2.remap(grey, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), inside


def _match(left: Image, right: Image, count: int, block: int = 5) -> Array32:
    """Disparity beyond `d_min`, NaN where left and right disagree."""
    sgm = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=block,
        P1=8 * block * block,
        P2=32 * block * block,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=8,
        speckleWindowSize=120,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # The left border of `count` columns cannot be matched otherwise.
    padded = [cv2.copyMakeBorder(x, 0, 0, count, 0, cv2.BORDER_REPLICATE) for x in (left, right)]
    raw = sgm.compute(padded[0], padded[1])[:, count:]
    return np.where(raw >= 0, raw / np.float32(16), np.nan).astype(np.float32)


def _disparity_sigma(left: Image, noise_grey: float, window: int = 7) -> Array32:
    """Standard deviation of a disparity, in pixels, by the texture along the row (Foerstner 1982).

    It is large on surfaces without texture, which semi-global matching fills from their borders.
    """
    gradient = cv2.Scharr(left, cv2.CV_32F, 1, 0, scale=1 / 32)
    energy = cv2.boxFilter(gradient * gradient, cv2.CV_32F, (window, window), normalize=False)
    # Subtract the gradients of the image noise. Scharr/32 passes about 0.19 of white noise.
    energy = np.maximum(energy - window * window * (0.19 * noise_grey) ** 2, 1e-3)
    return np.asarray(np.sqrt(0.2**2 + noise_grey**2 / energy), dtype=np.float32)


def _to_camera(disparity: Array32, sigma_d: Array32, camera: Camera, rect: _Rectified) -> tuple[Array32, Array32]:
    """z-depth on the camera's undistorted pixels, from rectified disparities."""
    rect_from_cam = rect.rotation @ camera.cam_from_world.rotation.T
    rays = pixel_rays(camera.intrinsics.undistorted()) @ rect_from_cam.T
    map_x = (rect.focal * rays[..., 0] / rays[..., 2] + rect.cx - 0.5).astype(np.float32)
    map_y = (rect.focal * rays[..., 1] / rays[..., 2] + rect.cy - 0.5).astype(np.float32)
    map_x[~_before(rays)] = -10.0  # beyond the rectified image
    nan = float("nan")
    d = cv2.remap(disparity, map_x, map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=nan)
    s = cv2.remap(sigma_d, map_x, map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=nan)
    total = d + rect.d_min
    total = np.where(total > 0, total, np.nan)  # no disparity: infinitely far, without a depth
    depth = (rect.focal * rect.baseline / total / rays[..., 2]).astype(np.float32)
    return depth, (depth * s / total).astype(np.float32)


def pixel_rays(intrinsics: Intrinsics) -> Array:
    """Rays (h, w, 3) with z = 1 through the pixel centres of a camera without distortion."""
    u = (np.arange(intrinsics.width) + 0.5 - intrinsics.cx) / intrinsics.fx
    v = (np.arange(intrinsics.height) + 0.5 - intrinsics.cy) / intrinsics.fy
    return np.stack([*np.meshgrid(u, v), np.ones((intrinsics.height, intrinsics.width))], axis=-1)
