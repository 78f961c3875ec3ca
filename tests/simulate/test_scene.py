# SPDX-License-Identifier: Apache-2.0
"""Rays, light and photos against what geometry says they must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from skymoor.geometry import Intrinsics
from skymoor.simulate.light.pages import WHITE, Pages
from skymoor.simulate.light.photo import Sensor, developed, take_photo, true_depth, true_labels
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import Label, Part, cuboid, join, parallelograms
from skymoor.types import Camera
from support.blocks import look_at

Array = NDArray[np.float64]

LENS = Intrinsics(160, 120, 140.0, 141.0, 83.0, 58.5, (-0.12, 0.03, 0.001, -0.0005))
SUN = np.array([0.6, 0.0, 0.8])
QUIET = Sensor(blur_px=0.0, noise=0.0, vignetting=0.0)


def make_scene(*parts: Part, pages: Pages | None = None, ripples: float = 0.0, haze: float = 0.0) -> Scene:
    pages = (pages or Pages()).copy()
    grain = pages.add(np.full((4, 4, 3), 0.5, np.float32), 0.01)
    slopes = np.full((8, 8, 2), ripples, np.float32)
    clouds = np.zeros((8, 8), np.float32)
    return Scene(join(parts), join([]), pages, grain, SUN, clouds, haze, slopes, lattice=(20.0, -1.0, 8.0))


def floor(tint: ArrayLike = (0.3, 0.3, 0.3), label: Label = Label.GROUND, size: float = 200.0) -> Part:
    return parallelograms([-size / 2, -size / 2, 0], [size, 0, 0], [0, size, 0], WHITE, label, tint)


def camera_at(centre: ArrayLike, target: ArrayLike) -> Camera:
    return Camera("a.jpg", LENS, look_at(np.array(centre, float), np.array(target, float)))


def test_rays_find_the_first_surface_with_its_label_and_normal() -> None:
    block = cuboid([2, -1, 0], np.diag([2.0, 2.0, 3.0]), WHITE, Label.WALL)
    hits = make_scene(floor(), block).cast([0, 0, 1.5], np.array([[1.0, 0, 0], [0, 0, -0.5], [0, 0, 1.0]]))
    np.testing.assert_allclose(hits.distance[:2], [2.0, 3.0], atol=1e-5)
    assert not np.isfinite(hits.distance[2])
    assert hits.label.tolist() == [Label.WALL, Label.GROUND, Label.SKY]
    np.testing.assert_allclose(hits.normal[:2], [[-1, 0, 0], [0, 0, 1]], atol=1e-6)


def test_a_block_throws_its_shadow_where_the_sun_says() -> None:
    # 4 m high, and the sun stands 53.1 degrees high in the east: the shadow reaches 3 m to the west.
    scene = make_scene(floor(), cuboid([0, -3, 0], np.diag([1.0, 6.0, 4.0]), WHITE, Label.WALL))
    west = -np.array([2.9, 3.1])
    origins = np.column_stack([west, [0, 0], [50, 50]])
    shaded, lit = scene.radiance(origins, np.tile([0, 0, -1.0], (2, 1)))
    assert 1.5 < lit.mean() / shaded.mean() < 8
    assert lit.mean() == pytest.approx(0.3 * (0.8 * 0.93 + 0.3), rel=0.25)


def test_places_between_walls_get_less_light_from_the_sky() -> None:
    walls = [cuboid([x, -12, 0], np.diag([0.5, 24.0, 7.5]), WHITE, Label.WALL) for x in (-2.5, 2.0)]
    scene = make_scene(floor(), *walls)
    below = np.tile([0, 0, -1.0], (2, 1))
    # The middle of the lane, and a free place in the shadow of the western wall.
    lane, free = scene.radiance(np.array([[0, 0, 5.0], [-5.0, 0, 5.0]]), below).mean(axis=1)
    assert 0.15 < lane / free < 0.85


def test_glass_shows_what_stands_before_it_and_a_wall_does_not() -> None:
    red = cuboid([5, -10, 0], np.diag([1.0, 20.0, 10.0]), WHITE, Label.WALL, (0.6, 0.02, 0.02))
    views = {}
    for label in (Label.GLASS, Label.WALL):
        pane = parallelograms([0, -3, 0], [0, 6, 0], [0, 0, 6], WHITE, label, (0.05, 0.05, 0.05))
        scene = make_scene(floor(), red, pane)
        slanted = np.array([-1.0, 1.0, 0]) / np.sqrt(2)
        views[label] = scene.radiance([[2.0, -2.0, 2.0]], [slanted])[0]
    assert views[Label.GLASS][0] > 1.5 * views[Label.WALL][0]
    assert views[Label.GLASS][0] > 1.3 * views[Label.GLASS][2]


def test_water_mirrors_more_at_a_flat_angle() -> None:
    scene = make_scene(floor((0.02, 0.02, 0.02), Label.WATER))
    down, flat = scene.radiance([[0, 0, 5.0]] * 2, [[0, 0.01, -1], [0, 1, -0.08]])
    assert 4 < flat.mean() / down.mean() < 80


def test_a_page_keeps_its_mean_at_every_size_and_its_texels_at_its_own() -> None:
    pages = Pages()
    rng = np.random.default_rng(1)
    albedo = rng.uniform(0.1, 0.7, (64, 96, 3)).astype(np.float32)
    number = pages.add(albedo, 0.5)
    rows, columns = np.array([3, 40]), np.array([90, 7])
    uv = (np.column_stack([columns, rows]) + 0.5).astype(np.float32) * np.float32(0.5)
    page = np.full(2, number, np.int16)
    np.testing.assert_allclose(pages.colours(page, uv, np.full(2, 0.1, np.float32)), albedo[rows, columns], atol=0.006)
    coarse = pages.colours(page, uv, np.full(2, 1000.0, np.float32))
    np.testing.assert_allclose(coarse, np.tile(albedo.mean(axis=(0, 1)), (2, 1)), atol=0.02)
    # Beyond its borders it repeats.
    again = pages.colours(page, uv + np.float32([48.0, -32.0]), np.full(2, 0.1, np.float32))
    np.testing.assert_allclose(again, albedo[rows, columns], atol=0.006)


def test_a_photo_shows_marks_where_the_lens_puts_them(rng: np.random.Generator) -> None:
    east, north = np.meshgrid(np.linspace(-5.2, 5.0, 8), np.linspace(-4.3, 3.6, 6))
    marks = np.column_stack([east.ravel(), north.ravel(), np.full(east.size, 0.01)])
    size = 0.4
    parts = [
        parallelograms(mark - [size / 2, size / 2, 0], [size, 0, 0], [0, size, 0], WHITE, Label.OBJECT, (0.9,) * 3)
        for mark in marks
    ]
    camera = camera_at([0, -1, 12], [0, 0, 0])
    photo = take_photo(make_scene(floor((0.01,) * 3), *parts), camera, QUIET, rng, samples=4)
    u, v = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    light = (photo.astype(float).mean(axis=2) / 255) ** 2.2
    errors = []
    for px in camera.intrinsics.px_from_cam(camera.cam_from_world.apply(marks)):
        weight = np.where(np.hypot(u - px[0], v - px[1]) < 5.5, light - light.min(), 0)
        errors.append(np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum() - px)
    # Half a pixel of a wrong convention, or a lens of the wrong sign, would show in the mean or in the spread.
    np.testing.assert_allclose(np.mean(errors, axis=0), 0, atol=0.06)
    assert np.abs(errors).max() < 0.3


def test_true_depths_lie_on_the_surface_that_was_seen() -> None:
    camera = camera_at([3, -20, 15], [0, 0, 0])
    scene = make_scene(floor(size=4000), cuboid([-2, -2, 0], np.diag([4.0, 4.0, 5.0]), WHITE, Label.WALL))
    depth, labels = true_depth(scene, camera), true_labels(scene, camera)
    v, u = np.nonzero(labels == Label.GROUND)
    rays = camera.intrinsics.rays(np.column_stack([u, v]) + 0.5)
    points = camera.cam_from_world.inverse().apply(rays * depth[v, u, None])
    assert 5000 < len(points) < 160 * 120
    assert np.abs(points[:, 2]).max() < 2e-3
    assert (labels == Label.WALL).sum() > 200


def test_the_sky_has_no_depth() -> None:
    camera = camera_at([0, 0, 2], [0, 10, 6])
    depth, labels = true_depth(make_scene(floor()), camera), true_labels(make_scene(floor()), camera)
    assert np.isnan(depth[0]).all()
    assert (labels[np.isnan(depth)] == Label.SKY).all()


def test_noise_is_what_was_asked_for() -> None:
    grey = np.full((200, 200, 3), 0.2, np.float32)
    quiet = developed(grey, QUIET, np.random.default_rng(0)).astype(float)
    assert quiet.std() < 0.5
    spreads = [
        developed(grey, replace(QUIET, noise=noise), np.random.default_rng(0)).astype(float).std() / 255
        for noise in (0.01, 0.02)
    ]
    assert 0.5 * 0.01 < spreads[0] < 1.5 * 0.01
    assert 1.7 < spreads[1] / spreads[0] < 2.3


def test_exposure_and_white_balance_change_the_photo_as_named(rng: np.random.Generator) -> None:
    scene, camera = make_scene(floor()), camera_at([0, -1, 12], [0, 0, 0])
    plain = take_photo(scene, camera, QUIET, rng, samples=1).mean(axis=(0, 1))
    bright = take_photo(scene, camera, replace(QUIET, exposure=1.5), rng, samples=1).mean(axis=(0, 1))
    warm = take_photo(scene, camera, replace(QUIET, white_balance=(1.2, 1.0, 0.8)), rng, samples=1).mean(axis=(0, 1))
    assert (bright > plain + 5).all()
    assert warm[0] > plain[0] + 3 and warm[2] < plain[2] - 3


def test_haze_takes_the_contrast_of_what_is_far() -> None:
    views = [
        make_scene(floor((0.05,) * 3, size=5000), haze=haze).radiance([[0, 0, 50]], [[0, 1, -0.05]])
        for haze in (0, 2e-3)
    ]
    assert views[1].mean() > 1.5 * views[0].mean()


def test_a_camera_in_the_shadow_exposes_longer_but_not_all_the_way(rng: np.random.Generator) -> None:
    lit, dim = (make_scene(floor((grey,) * 3)) for grey in (0.4, 0.1))
    camera = camera_at([0, -1, 12], [0, 0, 0])
    views = [take_photo(scene, camera, QUIET, rng, samples=1).mean() for scene in (lit, dim)]
    fixed = [developed(scene.radiance([[0, 0, 9]], [[0, 0, -1.0]])[None], QUIET, rng).mean() for scene in (lit, dim)]
    assert 1.05 < views[0] / views[1] < 0.8 * fixed[0] / fixed[1]
