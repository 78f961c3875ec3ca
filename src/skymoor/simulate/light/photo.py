# SPDX-License-Identifier: Apache-2.0
"""A camera in a scene: the photo that it takes, and what it sees in truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics
from skymoor.simulate.light.motion import STILL, Motion, blurred, swept_rays
from skymoor.simulate.light.scene import Scene
from skymoor.types import Camera, Image

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]


METERED_LIGHT = 0.22  # the mean light that needs no correction


@dataclass(frozen=True)
class Sensor:
    """What happens between the light and the file.

    Attributes:
        exposure: factor on the light, on top of what the camera meters.
        white_balance: factors on red, green and blue.
        blur_px: standard deviation of lens and motion blur.
        noise: standard deviation of the noise of a mid-grey pixel, as a share of white.
        vignetting: share of the light that is lost in the corners.
        quality: of the JPEG file.
    """

    exposure: float = 1.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur_px: float = 0.45
    noise: float = 0.008
    vignetting: float = 0.12
    quality: int = 93


def take_photo(
    scene: Scene,
    camera: Camera,
    sensor: Sensor,
    rng: np.random.Generator,
    *,
    samples: int = 2,
    motion: Motion = STILL,
) -> Image:
    """The photo (h, w, 3), with `samples` by `samples` rays per pixel."""
    i, in_camera = camera.intrinsics, _rays(camera.intrinsics, samples)
    if motion.readout_s > 0:
        light = scene.radiance(*swept_rays(camera, in_camera, motion), pixel_rad=1 / (i.fx * samples))
    else:
        rays = in_camera @ camera.cam_from_world.rotation.astype(np.float32)
        light = scene.radiance(camera.centre, rays, pixel_rad=1 / (i.fx * samples))
    light = light.reshape(i.height, samples, i.width, samples, 3).mean(axis=(1, 3))
    light = blurred(light, camera, motion)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px)
    u, v = np.meshgrid((np.arange(i.width) + 0.5) / i.width * 2 - 1, (np.arange(i.height) + 0.5) / i.height * 2 - 1)
    falloff = 1 - sensor.vignetting * ((u**2 + v**2) / 2).astype(np.float32)
    light = light * falloff[..., None]
    return developed(light * np.float32(_metered(light)), sensor, rng)


def _metered(light: Array32) -> float:
    """What a camera's automatic makes of the light, as a factor: what is dark stays a little darker."""
    mean = float(np.exp(np.log(np.maximum(light[::4, ::4], 0.01)).mean()))
    return float(np.clip((METERED_LIGHT / mean) ** 0.6, 0.5, 2.5))


def developed(light: Array32, sensor: Sensor, rng: np.random.Generator) -> Image:
    """Linear light (h, w, 3) as 8 bits: noise of photons and of the sensor, a film-like curve, gamma."""
    gain = 0.9 * sensor.exposure * np.asarray(sensor.white_balance, dtype=np.float32)
    linear = np.maximum(light, 0) * gain
    # Half of the noise grows with the root of the light; a pixel of 0.18 gets `noise` in all, as a share of white.
    spread = sensor.noise * np.sqrt(0.5 + 0.5 * linear / 0.18)
    linear = np.maximum(linear + spread * rng.standard_normal(linear.shape, dtype=np.float32) * 0.5, 0)
    # A little contrast in the shadows; highlights roll off instead of clipping.
    toned = linear * (linear + 0.035) / (linear + 0.06)
    grey = 255 * (1 - np.exp(-1.55 * toned**0.92)) ** (1 / 2.2)
    return np.asarray(grey + 0.5, dtype=np.uint8)


def true_depth(scene: Scene, camera: Camera) -> Array32:
    """z-depth (h, w) in metres at the pixel centres, along the distorted rays; NaN in the sky."""
    i = camera.intrinsics
    hits = scene.cast(camera.centre, _rays(i, 1) @ camera.cam_from_world.rotation.astype(np.float32))
    depth = np.where(np.isfinite(hits.distance), hits.distance, np.nan)
    return np.asarray(depth.reshape(i.height, i.width), dtype=np.float32)


def true_labels(scene: Scene, camera: Camera) -> NDArray[np.uint8]:
    """`Label` of each pixel's centre (h, w)."""
    i = camera.intrinsics
    hits = scene.cast(camera.centre, _rays(i, 1) @ camera.cam_from_world.rotation.astype(np.float32))
    return hits.label.reshape(i.height, i.width)


@lru_cache(maxsize=2)
def _rays(intrinsics: Intrinsics, samples: int) -> Array32:
    """Directions (n, 3), z = 1, through the centres of a raster `samples` times finer than the image's."""
    width, height = intrinsics.width * samples, intrinsics.height * samples
    u, v = np.meshgrid((np.arange(width) + 0.5) / samples, (np.arange(height) + 0.5) / samples)
    return intrinsics.rays(np.column_stack([u.ravel(), v.ravel()])).astype(np.float32)
