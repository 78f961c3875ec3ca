# SPDX-License-Identifier: Apache-2.0
"""The airborne photos of a small simulated site, their true depths, and the reconstruction that they ought to give."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from PIL import Image as PillowImage

from skymoor.simulate.light.pages import WHITE
from skymoor.simulate.light.photo import Sensor, developed, true_depth
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import Label, cuboid, join
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import Date, dates_of
from skymoor.simulate.site import Site
from skymoor.simulate.world import World
from skymoor.types import Camera, Component, DepthMap, Image, Photos
from support.blocks import observed
from support.sharing import shared

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

OPTIONS = SiteOptions(
    seed=5,
    radius_m=45.0,
    airborne=16,
    groups=1,
    group_photos=4,
    security=0,
    photo_width=400,
    reference_width_m=160.0,
    ortho_pixel_m=0.5,
)
STANDOFF_M = 78.0  # about; the unit of the `level` frames of the tests
TENT_LOW, TENT_HIGH = np.array([4.0, 18.0, -2.0]), np.array([20.0, 31.0, 7.0])  # opposite corners, east-north-up
ABOVE_M = 60.0  # over everything
QUIET = Sensor(blur_px=0.0, noise=0.0, vignetting=0.0)


@dataclass(frozen=True)
class SmallWorld(World):
    """A site in which a tent stands on which nothing can be measured; scenes are made once per test session."""

    factory: pytest.TempPathFactory = field(compare=False)

    def scene(self, date: Date) -> Scene:
        return _shared_scene(self, date)


@lru_cache(maxsize=2)
def _shared_scene(world: SmallWorld, date: Date) -> Scene:
    tent = cuboid(TENT_LOW, np.diag(TENT_HIGH - TENT_LOW), WHITE, Label.ROOF, (0.45, 0.45, 0.43))

    def make() -> Scene:
        scene = World.scene(world, date)
        return replace(scene, solid=join([scene.solid, tent]))

    return shared(world.factory, f"scene_{world.options.seed}_{date.name}", make)


def on_tent(east: ArrayLike, north: ArrayLike, *, margin_m: float = 2.0) -> Mask:
    """Whether plan positions lie on the tent's flat roof, so far from its edges, which can be measured."""
    plan = np.stack([np.asarray(east), np.asarray(north)], axis=-1)
    inside = (plan > TENT_LOW[:2] + margin_m) & (plan < TENT_HIGH[:2] - margin_m)
    return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True, eq=False)
class Flight:
    """Photos of a site, and the cameras that took them, in the site's frame."""

    world: World
    cameras: tuple[Camera, ...]
    images: dict[str, Image]

    @property
    def scene(self) -> Scene:
        """What the photos show."""
        return self.world.scene(dates_of(self.world.options).airborne)

    @property
    def photos(self) -> Photos:
        """As a reconstruction gets them."""
        sizes = tuple((c.intrinsics.width, c.intrinsics.height) for c in self.cameras)
        return Photos(tuple(self.images), sizes, self.images.__getitem__)

    @cached_property
    def from_above(self) -> list[int]:
        """The photos that look straight down."""
        return [k for k, camera in enumerate(self.cameras) if camera.cam_from_world.rotation[2, 2] < -0.98]

    @cached_property
    def around(self) -> list[int]:
        """The others, which look at the site from a ring, in the order of the ring."""
        ring = [k for k in range(len(self.cameras)) if k not in self.from_above]
        return sorted(ring, key=lambda k: np.arctan2(*self.cameras[k].centre[:2]))


def flight_of(world: World, site: Site) -> Flight:
    """The airborne photos that were written into a site's folder."""
    cameras = tuple(camera for name, camera in site.cameras.items() if name.startswith("airborne/"))
    images = {camera.image: np.array(PillowImage.open(site.folder / camera.image)) for camera in cameras}
    return Flight(world, cameras, images)


def true_maps(flight: Flight, *, sigma_ratio: float = 0.001) -> list[DepthMap]:
    """The depth maps that a perfect stereo engine would give, with colours that nothing has come between."""
    maps = []
    for camera in flight.cameras:
        pinhole = replace(camera, intrinsics=camera.intrinsics.undistorted())
        depth = true_depth(flight.scene, pinhole)
        sigma = (sigma_ratio * depth).astype(np.float32)
        maps.append(DepthMap(pinhole, depth, sigma, np.full(depth.shape, 3, np.uint8), true_colours(flight, pinhole)))
    return maps


def true_colours(flight: Flight, camera: Camera) -> Image:
    """What a perfect sensor makes of the light (h, w, 3), always with the same exposure."""
    i = camera.intrinsics
    u, v = np.meshgrid(np.arange(i.width) + 0.5, np.arange(i.height) + 0.5)
    rays = i.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation
    light = flight.scene.radiance(camera.centre, rays, pixel_rad=1 / i.fx)
    return as_colours(light.reshape(i.height, i.width, 3))


def as_colours(light: Array32) -> Image:
    """Light (..., 3) through a perfect sensor."""
    return developed(light, QUIET, np.random.default_rng(0))


def seen_from_above(
    scene: Scene, east: ArrayLike, north: ArrayLike, *, pixel_m: float = 0.2
) -> tuple[Array32, Array32]:
    """Light (..., 3) and height (...,) of what is highest at plan positions (...)."""
    plan = np.stack(np.broadcast_arrays(east, north), axis=-1)
    start = np.column_stack([plan.reshape(-1, 2), np.full(plan[..., 0].size, ABOVE_M)])
    down = np.broadcast_to(np.array([0, 0, -1], np.float32), start.shape)
    light = scene.radiance(start, down, pixel_m=pixel_m)
    up = ABOVE_M - scene.cast(start, down).distance
    return light.reshape(*plan.shape[:-1], 3), up.reshape(plan.shape[:-1])


def true_component(flight: Flight, *, per_photo: int = 400, seed: int = 5) -> Component:
    """The reconstruction of exact points, each seen by all cameras from which nothing hides it."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([_surface_points(flight.scene, camera, rng, per_photo) for camera in flight.cameras])

    def sees(camera: Camera, xyz: Array) -> Mask:
        return flight.scene.cast(camera.centre, xyz - camera.centre).distance > 0.998

    return observed(flight.cameras, points, sees=sees)


def _surface_points(scene: Scene, camera: Camera, rng: np.random.Generator, count: int) -> Array:
    i = camera.intrinsics
    rays = i.rays(rng.uniform([0, 0], [i.width, i.height], (count, 2))) @ camera.cam_from_world.rotation
    distance = scene.cast(camera.centre, rays).distance.astype(np.float64)
    hit = distance < 2.5 * STANDOFF_M
    return np.asarray(camera.centre + distance[hit, None] * rays[hit])
