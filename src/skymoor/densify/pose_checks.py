# SPDX-License-Identifier: Apache-2.0
"""Whether each photo shows what the others say that it should: a camera in a wrong place looks at something else.

Structure from motion may hang a photo on a look-alike, with hundreds of matches that all fit each other. Points of the
other photos' depth maps, seen from where the camera is said to be, make a picture that the photo must be like.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.densify.views import empty_depth_map
from skymoor.types import Array, Array32, Camera, DepthMap, Image, Mask, Photos

BLUR_PX, NEAR_RATIO = 1.0, 1.03  # of the pictures; depths that differ by less are one surface


@dataclass(frozen=True)
class AgreementOptions:
    """When a photo contradicts the others.

    Attributes:
        width_px: of the pictures that are compared.
        step_px, dense_maps: every so many pixels of a depth map, along rows and columns, lend a point; fewer in sets of
            more photos than that.
        max_ncc: correlation below which a photo may contradict. Right cameras had 0.69 to 0.99 on three real and
            simulated sets, and two on a look-alike 0.28 and 0.35.
        max_share: of the median correlation of the set, below which it must be as well.
        min_covered: share of the picture that the others must show.
        min_contrast: standard deviation of what they show, grey levels; a meadow contradicts nothing.
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
    """What the others say of a photo: correlation with what they show there, None where they show too little."""

    image: str
    ncc: float | None
    covered: float
    contradicts: bool


def check_poses(maps: Sequence[DepthMap], options: AgreementOptions | None = None) -> list[PoseCheck]:
    """Compare each photo with what the others show from its camera.

    Args:
        maps: depth maps of all cameras of a component in one frame; `empty_depth_map` for those without depth.
        options: see there.

    Returns:
        one check per map, in their order.
    """
    options = options or AgreementOptions()
    # Many photos show each place many times.
    sparse = options.step_px * max(1.0, np.sqrt(len(maps) / options.dense_maps))
    clouds = [depth_map.points(step=round(sparse)) for depth_map in maps]
    heard = _heard(maps, clouds, [True] * len(maps), options)
    if not any(check.contradicts for check in heard):
        return heard
    # Once more without what doubtful cameras lend: of two that see one place, the other may be the wrong one.
    return _heard(maps, clouds, [not check.contradicts for check in heard], options)


def check_camera_poses(
    cameras: Sequence[Camera], depths: Sequence[DepthMap], photos: Photos, options: AgreementOptions | None = None
) -> list[PoseCheck]:
    """`check_poses` for all cameras of a component, also for those whose photos have no depth map."""
    options = options or AgreementOptions()
    measured = {depth_map.camera.image for depth_map in depths}
    others = [camera for camera in cameras if camera.image not in measured]
    return check_poses([*depths, *(empty_depth_map(camera, photos, options.width_px) for camera in others)], options)


def _heard(
    maps: Sequence[DepthMap],
    clouds: Sequence[tuple[Array32, Image]],
    trusted: Sequence[bool],
    options: AgreementOptions,
) -> list[PoseCheck]:
    points = np.concatenate([np.zeros((0, 3), np.float32), *(xyz for xyz, _ in clouds)])
    grey = np.concatenate([np.zeros(0, np.float32), *(rgb.mean(axis=1, dtype=np.float32) for _, rgb in clouds)])
    owner = np.repeat(np.arange(len(maps)), [len(xyz) for xyz, _ in clouds])
    lends = np.asarray(trusted, bool)[owner] if len(owner) else np.zeros(0, bool)
    found = []
    for k, depth_map in enumerate(maps):
        others = lends & (owner != k)
        found.append(_compared(depth_map, points[others], grey[others], options))
    known = [ncc for ncc, _ in found if ncc is not None]
    limit = min(options.max_ncc, options.max_share * float(np.median(known))) if known else 0.0
    return [
        PoseCheck(depth_map.camera.image, ncc, covered, ncc is not None and ncc < limit)
        for depth_map, (ncc, covered) in zip(maps, found, strict=True)
    ]


def _compared(
    depth_map: DepthMap, points: Array32, grey: Array32, options: AgreementOptions
) -> tuple[float | None, float]:
    """Correlation of a photo with what points show from its camera, and the share that they cover."""
    h, w = depth_map.depth.shape
    shape = (max(1, round(h * options.width_px / w)), options.width_px)
    shown, weight = _splat(depth_map, points, grey, shape)
    covered = weight > 0.5
    if covered.mean() < options.min_covered:
        return None, float(covered.mean())
    photo = cv2.resize(depth_map.rgb, shape[::-1], interpolation=cv2.INTER_AREA).mean(axis=2, dtype=np.float32)
    photo = _blurred(photo, weight > 0)[0]
    a, b = (x[covered] - x[covered].mean() for x in (shown, photo))
    if a.std() < options.min_contrast:
        return None, float(covered.mean())
    return float((a * b).mean() / max(float(a.std() * b.std()), 1e-9)), float(covered.mean())


def _splat(depth_map: DepthMap, points: Array32, grey: Array32, shape: tuple[int, int]) -> tuple[Array32, Array32]:
    """The nearest points as a picture of `shape`, and how well each pixel is covered, 0 to 1."""
    camera = depth_map.camera
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


def _blurred(picture: Array32, known: Mask) -> tuple[Array32, Array32]:
    """Over the known pixels; and how much of each pixel's neighbourhood is known."""
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), BLUR_PX)
    total = cv2.GaussianBlur(np.where(known, picture, 0).astype(np.float32), (0, 0), BLUR_PX)
    return np.asarray(total / np.maximum(weight, 1e-6)), np.asarray(weight)
