# SPDX-License-Identifier: Apache-2.0
"""Cameras of every model that COLMAP knows: as `Intrinsics`, with photos resampled where those cannot state them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from skymoor.engines.colmap import component_from_colmap, intrinsics_of
from skymoor.errors import DegenerateGeometry, InputError
from skymoor.store.photos import PhotoFile, check_photos, photos_of
from skymoor.types import Array32, Component, Image, Photos

FEWEST_PHOTOS = 3
LARGEST_SIDE_PX = 100_000  # COLMAP goes along the border, pixel by pixel


@dataclass(frozen=True)
class Lens:
    """A camera as its file has it, by COLMAP's names, and the pinhole camera that replaces it."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]
    pinhole: tuple[int, int, float, float, float, float]

    def resampled(self, image: Image) -> Image:
        """A photo of this camera as the pinhole camera would have taken it."""
        u, v = _positions(self)
        return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8)


@lru_cache(maxsize=4)
def _positions(lens: Lens) -> tuple[Array32, Array32]:
    """Where the pixels of the pinhole camera lie in the photo, as OpenCV counts them."""
    width, height, fx, fy, cx, cy = lens.pinhole
    camera = pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))
    u, v = np.meshgrid((np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy)
    rays = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    px = np.asarray(camera.img_from_cam(rays), np.float64).reshape(height, width, 2)
    px = np.nan_to_num(px, nan=-1e4) - 0.5
    return px[..., 0].astype(np.float32), px[..., 1].astype(np.float32)


def without_distortion(model: pycolmap.Reconstruction, path: Path) -> dict[str, Lens]:
    """Replace cameras that `Intrinsics` cannot state by pinhole cameras, with all observations; the lens of each image.

    Changes `model`. Raises `InputError` for a camera that has no pinhole form, such as one of 360 degrees.
    """
    lenses: dict[int, Lens] = {}
    for camera_id, camera in list(model.cameras.items()):
        if not (0 < camera.width <= LARGEST_SIDE_PX and 0 < camera.height <= LARGEST_SIDE_PX):
            raise InputError(
                f"{path}: camera {camera_id} has {camera.width} by {camera.height} pixels; export the model again"
            )
        try:
            intrinsics_of(camera)
        except DegenerateGeometry:
            lenses[camera_id] = _replaced(model, camera_id, path)
    return {image.name: lenses[image.camera_id] for image in model.images.values() if image.camera_id in lenses}


def _replaced(model: pycolmap.Reconstruction, camera_id: int, path: Path) -> Lens:
    camera = model.camera(camera_id)
    name, size, params = camera.model.name, (camera.width, camera.height), tuple(map(float, camera.params))
    if camera.is_spherical():
        raise InputError(f"{path}: camera model {name} has no pinhole form; give the cloud or mesh of the model")
    options = pycolmap.UndistortCameraOptions()
    options.max_scale = 1.5
    pinhole = pycolmap.undistort_camera(options, camera)
    for image in model.images.values():
        if image.camera_id != camera_id:
            continue
        for point in image.points2D:
            ray = camera.cam_from_img(point.xy)
            if ray is None or not np.isfinite(ray).all():
                continue
            point.xy = pinhole.img_from_cam(np.array([*np.asarray(ray).ravel()[:2], 1.0]))
    camera.model, camera.width, camera.height = pinhole.model, pinhole.width, pinhole.height
    camera.params = list(map(float, pinhole.params))
    kept = (pinhole.width, pinhole.height, *map(float, pinhole.params))
    return Lens(name, *size, params, kept)  # type: ignore[arg-type]


def component_and_photos(
    model: pycolmap.Reconstruction, files: Mapping[str, Path], path: Path
) -> tuple[Component, Photos | None]:
    """Cameras with what they see, and their photos; without photos where fewer than three are there.

    Args:
        model: is changed. Cameras without a photo are left out, if three others have one.
        files: of the photos, by the names of images in the model.
        path: of the model, for messages.

    Raises `InputError` as `without_distortion`, and where a photo has not the size that the model states.
    """
    lenses = without_distortion(model, path)
    enough = sum(model.image(k).name in files for k in model.reg_image_ids()) >= FEWEST_PHOTOS
    for image in list(model.images.values()):
        if enough and image.name not in files and image.has_pose:
            model.deregister_frame(image.frame_id)
    component = component_from_colmap(model, {image.name: image.name for image in model.images.values()})
    return component, _photos(component, lenses, files, path) if enough else None


def _photos(component: Component, lenses: Mapping[str, Lens], files: Mapping[str, Path], path: Path) -> Photos:
    names = tuple(camera.image for camera in component.cameras)
    found = [PhotoFile(name, files[name]) for name in names]
    stated = [(c.intrinsics.width, c.intrinsics.height) for c in component.cameras]
    sizes = check_photos(found)
    raw = photos_of(found, sizes, None)
    for name, size, own in zip(names, sizes, stated, strict=True):
        expected = (lenses[name].width, lenses[name].height) if name in lenses else own
        if tuple(size) != expected:
            raise InputError(
                f"{files[name]}: has {size[0]} by {size[1]} pixels, and {path} was made from {expected[0]} by "
                f"{expected[1]}; give the folder of the photos that the model was made from"
            )

    def read(name: str) -> Image:
        image = raw.read(name)
        return lenses[name].resampled(image) if name in lenses else image

    return Photos(names, tuple(stated), read, [(name, files[name], lenses.get(name)) for name in names])
