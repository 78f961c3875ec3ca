# SPDX-License-Identifier: Apache-2.0
"""Photos of the small world from known cameras, their true depths, and the reconstruction that they ought to give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scene import Scene, make_scene
from skymoor.geometry.camera import Intrinsics
from skymoor.geometry.similarity import Similarity
from skymoor.types import Camera, Component, DepthMap, Image, Photos

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

LENS = Intrinsics(400, 300, 392.0, 392.0, 201.2, 148.7, (-0.05, 0.012, 0.0, 0.0))
HEIGHT_M = 64.0


@dataclass(frozen=True, eq=False)
class Flight:
    """A scene and the cameras over it; `photos` are named photo_00.jpg and so on, in the order of `cameras`."""

    scene: Scene
    cameras: tuple[Camera, ...]
    images: dict[str, Image]

    @property
    def photos(self) -> Photos:
        """As a reconstruction gets them."""
        sizes = tuple((c.intrinsics.width, c.intrinsics.height) for c in self.cameras)
        return Photos(tuple(self.images), sizes, self.images.__getitem__)

    @property
    def standoff_m(self) -> float:
        """Mean distance of the cameras to the middle of the site."""
        return float(np.mean([np.linalg.norm(c.centre) for c in self.cameras]))

    def with_scene(self, scene: Scene, indices: Sequence[int]) -> Flight:
        """Photos of another scene from some of the cameras."""
        return _taken(scene, [self.cameras[k] for k in indices])


def make_flight(kind: str, *, scene: Scene | None = None) -> Flight:
    """`oblique`: a ring that looks down at 45 degrees and six photos from above. `nadir`: 12 photos from one height."""
    return _taken(scene or make_scene(), make_cameras(kind))


def make_cameras(kind: str) -> list[Camera]:
    """The cameras of `make_flight`, named photo_00.jpg and so on."""
    rng = np.random.default_rng(7)
    poses = {"oblique": _oblique, "nadir": _nadir}[kind](rng)
    return [replace(camera, image=f"photo_{k:02d}.jpg") for k, camera in enumerate(poses)]


def look_at(centre: Array, target: Array, *, roll_deg: float = 0.0, up: Array | None = None) -> Similarity:
    """cam_from_world of a camera at `centre` whose axis meets `target`; `up` is upwards in the picture."""
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) if up is None else up)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    rotation = np.stack([c * x + s * y, c * y - s * x, z])
    return Similarity(1.0, rotation, -rotation @ centre)


def render_photo(scene: Scene, camera: Camera, *, noise_grey: float = 1.5, seed: int = 0) -> Image:
    """The photo (h, w, 3) with distortion, 2 by 2 rays per pixel, and sensor noise."""
    i = camera.intrinsics
    rays = _rays(i, 2) @ camera.cam_from_world.rotation
    colours = scene.colours(camera.centre, rays).reshape(i.height, 2, i.width, 2, 3).mean(axis=(1, 3))
    noise = np.random.default_rng([seed, 3]).normal(scale=noise_grey, size=colours.shape)
    return encoded(colours, noise)


def encoded(linear: Array32, noise: Array | float = 0.0, *, gamma: float = 2.2) -> Image:
    """Linear colours to 8 bits."""
    grey = 255 * np.clip(1.1 * linear, 0, 1) ** (1 / gamma) + noise
    return np.asarray(np.clip(grey + 0.5, 0, 255), dtype=np.uint8)


def true_depth(scene: Scene, camera: Camera) -> Array32:
    """z-depth (h, w) at the pixel centres of a camera, with its distortion if it has one."""
    i = camera.intrinsics
    t, index, _ = scene.cast(camera.centre, _rays(i, 1) @ camera.cam_from_world.rotation)
    return np.asarray(np.where(index < 0, np.nan, t).reshape(i.height, i.width), dtype=np.float32)


def true_maps(flight: Flight, *, sigma_ratio: float = 0.001) -> list[DepthMap]:
    """The depth maps that a perfect stereo engine would give."""
    maps = []
    for camera in flight.cameras:
        pinhole = replace(camera, intrinsics=replace(camera.intrinsics, distortion=(0.0, 0.0, 0.0, 0.0)))
        depth = true_depth(flight.scene, pinhole)
        rgb = render_photo(flight.scene, pinhole, noise_grey=0.0)
        sigma = (sigma_ratio * depth).astype(np.float32)
        maps.append(DepthMap(pinhole, depth, sigma, np.full(depth.shape, 3, np.uint8), rgb))
    return maps


def true_component(flight: Flight, *, per_photo: int = 400, seed: int = 5) -> Component:
    """The reconstruction of exact points, each seen by all cameras from which nothing hides it."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([_surface_points(flight.scene, camera, rng, per_photo) for camera in flight.cameras])
    cameras, indices, pixels = [], [], []
    for k, camera in enumerate(flight.cameras):
        px, seen = visible(flight.scene, camera, points)
        cameras.append(np.full(np.count_nonzero(seen), k, np.int32))
        indices.append(np.flatnonzero(seen).astype(np.int32))
        pixels.append(px[seen])
    colours = np.full((len(points), 3), 128, np.uint8)
    observations = np.concatenate(cameras), np.concatenate(indices), np.concatenate(pixels)
    return Component(flight.cameras, points, colours, *observations, reprojection_px=0.0)


def visible(scene: Scene, camera: Camera, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels (n, 2) of points, and whether they are in the picture with nothing before them."""
    i = camera.intrinsics
    px = i.px_from_cam(camera.cam_from_world.apply(points))
    with np.errstate(invalid="ignore"):
        inside = (px >= 0).all(axis=1) & (px[:, 0] <= i.width) & (px[:, 1] <= i.height)
    t, _, _ = scene.cast(camera.centre, points - camera.centre)
    return px, inside & (t > 0.998)


def _surface_points(scene: Scene, camera: Camera, rng: np.random.Generator, count: int) -> Array:
    i = camera.intrinsics
    px = rng.uniform([0, 0], [i.width, i.height], (count, 2))
    rays = i.rays(px) @ camera.cam_from_world.rotation
    t, index, _ = scene.cast(camera.centre, rays)
    hit = (index >= 0) & (t < 3 * HEIGHT_M)
    return np.asarray(camera.centre + t[hit, None] * rays[hit])


def _taken(scene: Scene, cameras: Sequence[Camera]) -> Flight:
    images = {camera.image: render_photo(scene, camera, seed=k) for k, camera in enumerate(cameras)}
    return Flight(scene, tuple(cameras), images)


@cache
def _rays(intrinsics: Intrinsics, subpixels: int) -> Array:
    """Directions (n, 3), z = 1, through the centres of a raster `subpixels` times finer than the image's."""
    width, height = intrinsics.width * subpixels, intrinsics.height * subpixels
    u, v = np.meshgrid((np.arange(width) + 0.5) / subpixels, (np.arange(height) + 0.5) / subpixels)
    return intrinsics.rays(np.column_stack([u.ravel(), v.ravel()]))


def _oblique(rng: np.random.Generator) -> Iterator[Camera]:
    for azimuth in np.radians(np.arange(0, 360, 30) + rng.uniform(-4, 4, 12)):
        out = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        centre = HEIGHT_M * out + [0, 0, HEIGHT_M + rng.uniform(-2, 2)]
        target = np.array([*rng.uniform(-6, 6, 2), 0.0])
        yield Camera("", LENS, look_at(centre, target, roll_deg=rng.normal(scale=0.7)))
    for east in (-22.0, 0.0, 22.0):
        for north in (-16.0, 16.0):
            yield _downwards(np.array([east, north]) + rng.uniform(-2, 2, 2), HEIGHT_M + 4, rng.uniform(0, 360), rng)


def _nadir(rng: np.random.Generator) -> Iterator[Camera]:
    for row, north in enumerate((-22.0, 0.0, 22.0)):
        for east in (-30.0, -10.0, 10.0, 30.0):
            heading = 0.0 if row % 2 else 180.0
            yield _downwards(np.array([east, north]) + rng.uniform(-1, 1, 2), HEIGHT_M, heading + rng.normal(), rng)


def _downwards(plan: Array, height: float, heading_deg: float, rng: np.random.Generator) -> Camera:
    centre = np.array([*plan, height])
    target = centre - [0, 0, height] + np.array([*rng.normal(scale=0.8, size=2), 0.0])
    heading = np.radians(heading_deg)
    return Camera("", LENS, look_at(centre, target, up=np.array([np.sin(heading), np.cos(heading), 0.0])))
