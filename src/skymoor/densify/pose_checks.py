# SPDX-License-Identifier: Apache-2.0
"""Pose check: compare each photo with a rendering of the other photos' depth maps from its estimated pose.

Structure from motion may attach a photo to a look-alike, with hundreds of consistent matches. The points of the other
photos' depth maps, rendered from the estimated pose, must resemble the photo.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.densify.views import empty_depth_map
from skymoor.types import Array, Array32, Camera, DepthMap, Mask, Photos

BLUR_PX, NEAR_RATIO = 1.0, 1.03  # blur of the images; ratio of depths below which they are one surface


@dataclass(frozen=True)
class AgreementOptions:
    """When a photo contradicts the others.

    Attributes:
        width_px: of the compared images.
        step_px, dense_maps: depth maps are sampled at every `step_px`-th pixel along rows and columns, more sparsely in
            sets of more than `dense_maps` photos.
        max_ncc: correlation below which a photo may contradict. Right cameras had 0.69 to 0.99 on three real and
            simulated sets, two cameras at a look-alike 0.28 and 0.35.
        max_share: share of the median correlation of the set, below which it must be as well.
        min_covered: share of the image that the rendering must cover.
        min_contrast: standard deviation of the rendering in grey levels; uniform surfaces are not tested.
    """

    width_px: int = 160
    step_px: int = 4
    dense_maps: int = 16
    max_ncc: float = 0.5
    max_share: float = 0.6
    min_covered: float = 0.1
    min_contrast: float = 6.0


@dataclass(frozen=True)
class PoseCheck:
    """Consistency of one photo: its correlation with the rendering, None where that shows too little."""

    image: str
    ncc: float | None
    covered: float
    contradicts: bool


@dataclass(frozen=True, eq=False)
class _Seen:
    """What is compared of one depth map: its camera and its grey photo (h, w), reduced, and some of its points."""

    camera: Camera
    photo: Array32
    points: Array32
    grey: Array32


def check_poses(
    maps: Iterable[DepthMap], options: AgreementOptions | None = None, *, count: int | None = None
) -> list[PoseCheck]:
    """Compare each photo with a rendering of the others' depth maps from its camera.

    Args:
        maps: depth maps of all cameras of a component in one frame; `empty_depth_map` for those without depth. They are
            looked at once, one after the other.
        options: see there.
        count: how many maps there are, where they have no length.

    Returns:
        one check per map, in their order.
    """
    options = options or AgreementOptions()
    if count is None:
        maps = list(maps)
        count = len(maps)
    # In large sets each surface is in many photos.
    step_px = options.step_px * max(1.0, np.sqrt(count / options.dense_maps))
    seen = [_seen(depth_map, round(step_px), options.width_px) for depth_map in maps]
    checks = _checked(seen, [True] * len(seen), options)
    if not any(check.contradicts for check in checks):
        return checks
    # Again without the points of contradicting cameras: of two at one place, the other one may be wrong.
    return _checked(seen, [not check.contradicts for check in checks], options)


def check_camera_poses(
    cameras: Sequence[Camera], depths: Sequence[DepthMap], photos: Photos, options: AgreementOptions | None = None
) -> list[PoseCheck]:
    """`check_poses` for all cameras of a component, also for those whose photos have no depth map."""
    options = options or AgreementOptions()
    width_px, measured = options.width_px, set[str]()

    def maps() -> Iterator[DepthMap]:
        for depth_map in depths:
            measured.add(depth_map.camera.image)
            yield depth_map
        for camera in cameras:
            if camera.image not in measured:
                yield empty_depth_map(camera, photos, width_px)

    return check_poses(maps(), options, count=len(cameras))


def _seen(depth_map: DepthMap, step: int, width_px: int) -> _Seen:
    h, w = depth_map.depth.shape
    size = (width_px, max(1, round(h * width_px / w)))
    photo = cv2.resize(depth_map.rgb, size, interpolation=cv2.INTER_AREA).mean(axis=2, dtype=np.float32)
    points, rgb = depth_map.points(step=step)
    return _Seen(depth_map.camera, photo, points, rgb.mean(axis=1, dtype=np.float32))


def _checked(seen: Sequence[_Seen], consistent: Sequence[bool], options: AgreementOptions) -> list[PoseCheck]:
    """One check per map, against the points of all other maps that are `consistent`."""
    points = np.concatenate([np.zeros((0, 3), np.float32), *(one.points for one in seen)])
    grey = np.concatenate([np.zeros(0, np.float32), *(one.grey for one in seen)])
    owner = np.repeat(np.arange(len(seen)), [len(one.points) for one in seen])
    used = np.asarray(consistent, bool)[owner] if len(owner) else np.zeros(0, bool)
    compared = []
    for k, one in enumerate(seen):
        others = used & (owner != k)
        compared.append(_correlation(one, points[others], grey[others], options))
    known = [ncc for ncc, _ in compared if ncc is not None]
    limit = min(options.max_ncc, options.max_share * float(np.median(known))) if known else 0.0
    return [
        PoseCheck(one.camera.image, ncc, covered, ncc is not None and ncc < limit)
        for one, (ncc, covered) in zip(seen, compared, strict=True)
    ]


def _correlation(seen: _Seen, points: Array32, grey: Array32, options: AgreementOptions) -> tuple[float | None, float]:
    """Correlation of a photo with the rendered points, None where that shows too little, and their coverage."""
    rendered, weight = _splat(seen.camera, points, grey, seen.photo.shape)
    covered = weight > 0.5
    if covered.mean() < options.min_covered:
        return None, float(covered.mean())
    photo = _blurred(seen.photo, weight > 0)[0]
    a, b = (x[covered] - x[covered].mean() for x in (rendered, photo))
    if a.std() < options.min_contrast:
        return None, float(covered.mean())
    return float((a * b).mean() / max(float(a.std() * b.std()), 1e-9)), float(covered.mean())


def _splat(camera: Camera, points: Array32, grey: Array32, shape: tuple[int, ...]) -> tuple[Array32, Array32]:
    """Rendering of the nearest points, of `shape` (h, w), and the coverage of each pixel, 0 to 1."""
    xyz = camera.cam_from_world.apply(points)
    front = np.flatnonzero(xyz[:, 2] > 0)
    scale: Array = np.array(shape[::-1]) / [camera.intrinsics.width, camera.intrinsics.height]
    px = camera.intrinsics.px_from_cam(xyz[front]) * scale
    inside = (px >= 0).all(axis=1) & (px < shape[::-1]).all(axis=1)
    u, v = px[inside].astype(np.intp).T
    z, colour = xyz[front[inside], 2].astype(np.float32), grey[front[inside]]
    nearest = np.full(shape, np.inf, np.float32)
    np.minimum.at(nearest, (v, u), z)
    near = z <= NEAR_RATIO * cv2.erode(nearest, np.ones((3, 3), np.uint8))[v, u]
    flat = v[near] * shape[1] + u[near]
    count = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
    total = np.bincount(flat, colour[near], minlength=shape[0] * shape[1]).reshape(shape)
    return _blurred((total / np.maximum(count, 1)).astype(np.float32), count > 0)


def _blurred(image: Array32, known: Mask) -> tuple[Array32, Array32]:
    """Gaussian blur over the known pixels; and the known share of each pixel's neighbourhood."""
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), BLUR_PX)
    total = cv2.GaussianBlur(np.where(known, image, 0).astype(np.float32), (0, 0), BLUR_PX)
    return np.asarray(total / np.maximum(weight, 1e-6)), np.asarray(weight)
