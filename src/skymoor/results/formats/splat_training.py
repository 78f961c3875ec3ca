# SPDX-License-Identifier: Apache-2.0
"""Photos without distortion and their COLMAP model, as trainers of Gaussian splats read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap
from PIL import Image as PillowImage

from skymoor.engines.colmap import colmap_from_component, intrinsics_of
from skymoor.geometry import Intrinsics
from skymoor.results.formats.names import bare_names
from skymoor.types import Array, Component, Image

KEPT = (".jpg", ".jpeg", ".png")
QUALITY = 95  # of JPEG: an undistorted photo is encoded a second time


def pinhole_component(component: Component) -> Component:
    """The component as undistorted photos show it, with bare file names.

    Images have the largest size at which no pixel is empty (COLMAP's undistortion with `blank_pixels` 0); observations
    are moved with the pixels.
    """
    lenses = {camera.intrinsics: pinhole_of(camera.intrinsics) for camera in component.cameras}
    moved: Array = np.array(component.obs_px, np.float64)
    for k, camera in enumerate(component.cameras):
        own = component.obs_camera == k
        moved[own] = lenses[camera.intrinsics].px_from_cam(camera.intrinsics.rays(component.obs_px[own]))
    names = training_names(component)
    cameras = tuple(
        replace(one, image=names[one.image], intrinsics=lenses[one.intrinsics]) for one in component.cameras
    )
    return replace(component, cameras=cameras, obs_px=moved)


def training_names(component: Component) -> dict[str, str]:
    """The name of each image: trainers know JPEG and PNG, and some of them no sub-folders."""
    names = bare_names(camera.image for camera in component.cameras)
    return {
        image: name if PurePosixPath(name).suffix.lower() in KEPT else f"{name}.jpg" for image, name in names.items()
    }


def pinhole_of(lens: Intrinsics) -> Intrinsics:
    """The camera of an undistorted photo; the same where there is no distortion."""
    if not any(lens.distortion):
        return lens
    return intrinsics_of(pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), _colmap(lens)))


def undistorted(pixels: Image, lens: Intrinsics) -> Image:
    """A photo (h, w, 3) as `pinhole_of` its lens shows it."""
    bitmap, _ = pycolmap.undistort_image(
        pycolmap.UndistortCameraOptions(), pycolmap.Bitmap.from_array(np.ascontiguousarray(pixels)), _colmap(lens)
    )
    return np.asarray(bitmap.to_array(), np.uint8)


def write_pinhole_model(component: Component, folder: Path) -> None:
    """A component without distortion as binary COLMAP model with PINHOLE cameras, which splat trainers require."""
    model = colmap_from_component(component)
    for camera in model.cameras.values():
        camera.model, camera.params = pycolmap.CameraModelId.PINHOLE, camera.params[:4]
    model.write(str(folder))


def write_photo(pixels: Image, path: Path) -> None:
    """A photo (h, w, 3) as JPEG or PNG, by the name."""
    picture = PillowImage.fromarray(pixels)
    if path.suffix.lower() == ".png":
        picture.save(path)
    else:
        picture.save(path, quality=QUALITY, subsampling=0)


def _colmap(lens: Intrinsics) -> pycolmap.Camera:
    params = [lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion]
    return pycolmap.Camera(model="OPENCV", width=lens.width, height=lens.height, params=params)
