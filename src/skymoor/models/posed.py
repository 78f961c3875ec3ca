# SPDX-License-Identifier: Apache-2.0
"""Cameras that a file states one by one, with points that it does not tie to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.errors import InputError
from skymoor.models.cameras import component_and_photos
from skymoor.types import Array, Component, Image, Photos

MOST_TIES = 6000
"""Points that are projected to the cameras, to know which of them see the same."""


@dataclass(frozen=True, eq=False)
class Posed:
    """A camera: image, COLMAP's name of its model, its size and parameters, and its pose from the model's world."""

    image: str
    model: str
    width: int
    height: int
    params: tuple[float, ...]
    rotation: Array
    translation: Array


def component_of_posed(
    cameras: Sequence[Posed], points: Array, colours: Image | None, files: Mapping[str, Path], path: Path
) -> tuple[Component, Photos | None]:
    """Cameras with the points that lie in their view, and their photos where they are there.

    Which camera sees which point is not stated: every point in view counts, hidden or not, which is enough to know
    the cameras' neighbours. Raises `InputError` for poses that are none, and as `component_and_photos`.
    """
    model, lenses = pycolmap.Reconstruction(), dict[tuple[object, ...], int]()
    for index, one in enumerate(cameras):
        key = (one.model, one.width, one.height, one.params)
        if key not in lenses:
            lenses[key] = len(lenses) + 1
            model.add_camera_with_trivial_rig(_camera(one, lenses[key], path))
        if not np.isfinite(one.rotation).all() or not np.isfinite(one.translation).all():
            raise InputError(f"{path}: the pose of {one.image} is not finite; export it again")
        off = np.abs(one.rotation @ one.rotation.T - np.eye(3)).max()
        if off > 1e-3 or np.linalg.det(one.rotation) < 0:
            raise InputError(f"{path}: the pose of {one.image} is no rotation, or is mirrored; export it again")
        u, _, vt = np.linalg.svd(one.rotation)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(u @ vt), one.translation)
        image = pycolmap.Image(name=one.image, camera_id=lenses[key], image_id=index + 1)
        model.add_image_with_trivial_frame(image, pose)
    component, photos = component_and_photos(model, files, path)
    chosen = np.random.default_rng(0).permutation(len(points))[:MOST_TIES]
    shown = np.zeros((len(chosen), 3), np.uint8) if colours is None else colours[chosen]
    return _tied(replace(component, points=points[chosen], colours=shown, reprojection_px=float("nan"))), photos


def _camera(one: Posed, camera_id: int, path: Path) -> pycolmap.Camera:
    params = np.asarray(one.params, np.float64)
    if not params.size or not np.isfinite(params).all() or params[0] <= 0 or one.width < 1 or one.height < 1:
        raise InputError(f"{path}: the camera of {one.image} has no focal length or size; export it again")
    return pycolmap.Camera(
        model=one.model, width=one.width, height=one.height, params=params.tolist(), camera_id=camera_id
    )


def _tied(component: Component) -> Component:
    """With an observation wherever a point lies in the view of a camera."""
    seen_by, seen, at = [], [], []
    for index, camera in enumerate(component.cameras):
        px = camera.intrinsics.px_from_cam(camera.cam_from_world.apply(component.points))
        with np.errstate(invalid="ignore"):
            size = [camera.intrinsics.width, camera.intrinsics.height]
            inside = np.flatnonzero(((px >= 0) & (px < size)).all(axis=1))
        seen_by.append(np.full(len(inside), index, np.int32))
        seen.append(inside.astype(np.int32))
        at.append(px[inside])
    none = np.zeros(0, np.int32)
    return replace(
        component,
        obs_camera=np.concatenate([none, *seen_by]),
        obs_point=np.concatenate([none, *seen]),
        obs_px=np.concatenate([np.zeros((0, 2)), *at]),
    )
