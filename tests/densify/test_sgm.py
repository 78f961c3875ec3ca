# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching against true depths, from true cameras."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.densify import SgmDepth
from skymoor.densify._sgm import _Rectified, _rectify, _to_camera, _warp, pair_depth
from skymoor.densify.neighbours import depth_range
from skymoor.geometry import Intrinsics, Similarity
from skymoor.simulate.light.photo import true_depth
from skymoor.types import Camera, DepthMap, Photos
from support.flight import Flight, on_tent, true_component

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def maps(flight: Flight) -> list[DepthMap]:
    return list(SgmDepth()(true_component(flight), flight.photos))


@pytest.fixture(scope="module")
def truths(flight: Flight, maps: list[DepthMap]) -> list[Array]:
    return [true_depth(flight.scene, depth_map.camera).astype(np.float64) for depth_map in maps]


def surface(camera: Camera, depth: Array) -> Array:
    """World points (h, w, 3) of an undistorted depth map."""
    i = camera.intrinsics
    u, v = np.meshgrid(np.arange(i.width) + 0.5, np.arange(i.height) + 0.5)
    rays = i.rays(np.stack([u.ravel(), v.ravel()], axis=1)) @ camera.cam_from_world.rotation
    return (camera.centre + depth.reshape(-1, 1) * rays).reshape(i.height, i.width, 3)


def both_known(depth_map: DepthMap, truth: Array) -> NDArray[np.bool_]:
    """A ray in a million slips between two triangles of the terrain: there is no truth there."""
    return np.isfinite(depth_map.depth) & np.isfinite(truth)


def plain_pixels(camera: Camera, depth: Array) -> NDArray[np.bool_]:
    """Pixels two metres or more inside the tent's roof, which has no texture."""
    xyz = surface(camera, depth)
    return on_tent(xyz[..., 0], xyz[..., 1]) & (xyz[..., 2] > 4)


def test_one_undistorted_map_per_photo(flight: Flight, maps: list[DepthMap]) -> None:
    assert [m.camera.image for m in maps] == list(flight.images)
    for depth_map in maps:
        assert not any(depth_map.camera.intrinsics.distortion)
        assert depth_map.rgb.shape == (*depth_map.depth.shape, 3) == (300, 400, 3)
        np.testing.assert_array_equal(np.isfinite(depth_map.depth), np.isfinite(depth_map.sigma))


def test_complete_and_accurate(maps: list[DepthMap], truths: list[Array]) -> None:
    errors = []
    for depth_map, truth in zip(maps, truths, strict=True):
        known = both_known(depth_map, truth)
        assert known.mean() > 0.4
        error = (depth_map.depth[known] / truth[known]) - 1
        assert np.median(np.abs(error)) < 0.003
        errors.append(error)
    every = np.concatenate(errors)
    # Both sides: neither too near nor too far, and no better than a twentieth of a pixel's disparity can be.
    assert abs(np.median(every)) < 0.0004
    assert 0.0001 < np.median(np.abs(every)) < 0.0014
    assert np.mean(np.abs(every) > 0.01) < 0.04


def test_sigma_predicts_the_errors_of_depths(maps: list[DepthMap], truths: list[Array]) -> None:
    pairs = [(m, t, both_known(m, t)) for m, t in zip(maps, truths, strict=True)]
    normalised = np.concatenate([((m.depth - t) / m.sigma)[known] for m, t, known in pairs])
    # The median of a normal distribution's absolute values is 0.67.
    assert 0.4 < np.median(np.abs(normalised)) < 1.0
    relative = np.concatenate([(m.sigma / m.depth)[known] for m, _, known in pairs])
    errors = np.concatenate([np.abs(m.depth / t - 1)[known] for m, t, known in pairs])
    order = np.argsort(relative)
    thirds = [errors[part].mean() for part in np.array_split(order, 3)]
    assert thirds[0] < thirds[1] < thirds[2]


def test_depths_from_above_are_more_certain_than_from_the_side(flight: Flight, maps: list[DepthMap]) -> None:
    # Nearer, and at larger angles: the prediction must know the geometry.
    oblique = np.nanmedian(np.concatenate([maps[k].sigma.ravel() for k in flight.around]))
    nadir = np.nanmedian(np.concatenate([maps[k].sigma.ravel() for k in flight.from_above]))
    assert nadir < oblique


def test_a_roof_without_texture_is_uncertain(maps: list[DepthMap], truths: list[Array]) -> None:
    for depth_map, truth in zip(maps, truths, strict=True):
        plain = plain_pixels(depth_map.camera, truth)
        known = plain & np.isfinite(depth_map.depth)
        if known.sum() > 200:
            elsewhere = np.median(depth_map.sigma[np.isfinite(depth_map.depth) & ~plain])
            assert np.median(depth_map.sigma[known]) > 20 * elsewhere
            assert (depth_map.sigma[known] < 20 * elsewhere).sum() < 0.05 * plain.sum()


@pytest.mark.parametrize(("one", "other"), [(15, 14), (14, 15), (2, 11), (12, 0)])
class TestRectification:
    """With true disparities in place of measured ones: no pixel convention may shift anything."""

    def pair(self, flight: Flight, one: int, other: int) -> tuple[_Rectified, Array, Array]:
        """The common image plane, its pixel centres (h, w, 2), and the true disparity beyond `d_min`."""
        a, b = flight.cameras[one], flight.cameras[other]
        rect = _rectify(a, b, *depth_range(true_component(flight), one))
        assert rect is not None
        w, h = rect.size
        centres = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1)
        rays = np.concatenate([(centres - [rect.cx, rect.cy]) / rect.focal, np.ones((h, w, 1))], axis=-1)
        z = flight.scene.cast(a.centre, rays.reshape(-1, 3) @ rect.rotation).distance
        z = np.minimum(z, 1e4)  # the sky
        return rect, centres, rect.focal * rect.baseline / z.reshape(h, w).astype(np.float64) - rect.d_min

    def test_depths_return_to_their_own_pixels(self, flight: Flight, truths: list[Array], one: int, other: int) -> None:
        rect, _, disparity = self.pair(flight, one, other)
        exact = disparity.astype(np.float32)
        depth, sigma = _to_camera(exact, np.full_like(exact, 0.5), flight.cameras[one], rect)
        error = depth - truths[one]
        down, across = np.gradient(truths[one])
        with np.errstate(invalid="ignore"):
            use = (np.abs(error) < 0.006 * truths[one]) & (np.hypot(down, across) < 1.0)
        assert use.sum() > 20_000
        shift = np.linalg.lstsq(np.stack([across[use], down[use]], axis=1), error[use], rcond=None)[0]
        assert np.abs(shift).max() < 0.05
        # Half a pixel of disparity moves the depth by as much as sigma says.
        nearer, _ = _to_camera(exact + 0.5, np.full_like(exact, 0.5), flight.cameras[one], rect)
        assert np.median(((depth - nearer) / sigma)[use]) == pytest.approx(1.0, abs=0.05)

    def test_each_pixel_shows_its_own_ray(self, flight: Flight, one: int, other: int) -> None:
        rect, centres, _ = self.pair(flight, one, other)
        camera = flight.cameras[one]
        image = flight.images[camera.image]
        warped, inside = _warp(image, camera, rect, rect.cx)
        flat = (centres - [rect.cx, rect.cy]) / rect.focal
        rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=-1).reshape(-1, 3) @ rect.rotation
        px = camera.intrinsics.px_from_cam(rays @ camera.cam_from_world.rotation.T).reshape(centres.shape) - 0.5
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        u, v = np.nan_to_num(px, nan=-9.0).astype(np.float32).transpose(2, 0, 1)
        expected = cv2.remap(grey, u, v, cv2.INTER_LINEAR)
        # Rounding of OpenCV's weights; half a pixel beside they differ by 6 grey levels and more.
        assert np.abs(warped.astype(float) - expected)[inside].mean() < 1.0

    def test_rows_of_both_pictures_show_the_same(self, flight: Flight, one: int, other: int) -> None:
        rect, centres, disparity = self.pair(flight, one, other)
        cameras = flight.cameras[one], flight.cameras[other]
        (left, inside), (right, _) = (
            _warp(flight.images[camera.image], camera, rect, cx)
            for camera, cx in zip(cameras, (rect.cx, rect.cx + rect.d_min), strict=True)
        )

        def seen(du: float, dv: float) -> Array:
            """The right picture at the true place of each pixel of the left one, and so much beside it."""
            u, v = centres[..., 0] - disparity - 0.5 + du, centres[..., 1] - 0.5 + dv
            return np.asarray(cv2.remap(right, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR), float)

        inside[:, : round(disparity.max())] = False
        inside &= np.abs(seen(0, 0) - left) < 30  # the rest is hidden from the right
        for direction in ((1.0, 0.0), (0.0, 1.0)):
            steps = np.array([-0.5, 0.0, 0.5])
            gap = [np.mean((seen(t * direction[0], t * direction[1]) - left)[inside] ** 2) for t in steps]
            bend, slope, _ = np.polyfit(steps, gap, 2)
            assert bend > 0
            assert abs(-slope / (2 * bend)) < 0.1  # where it agrees best, in pixels


def test_smaller_maps_are_coarser_but_right(flight: Flight, truths: list[Array]) -> None:
    component = true_component(flight)
    (small, *_) = SgmDepth(max_px=200)(component, flight.photos)
    assert small.depth.shape == (150, 200)
    assert small.camera.intrinsics == component.cameras[0].intrinsics.resized(200, 150).undistorted()
    truth = true_depth(flight.scene, small.camera)
    error = (small.depth / truth - 1)[np.isfinite(small.depth) & np.isfinite(truth)]
    assert abs(np.median(error)) < 0.001 and np.median(np.abs(error)) < 0.003


def test_photos_without_partners_give_no_map(flight: Flight) -> None:
    component = true_component(flight)
    lonely = replace(component, cameras=component.cameras[:2], obs_camera=component.obs_camera[:1] * 0)
    lonely = replace(lonely, obs_point=component.obs_point[:1], obs_px=component.obs_px[:1])
    photos = Photos(flight.photos.names[:2], flight.photos.sizes[:2], flight.photos.read)
    assert list(SgmDepth()(lonely, photos)) == []


def test_a_camera_that_looks_along_the_way_has_depth_beside_it() -> None:
    """A dash camera: the corners of its photos are beyond 90 degrees of any axis across the baseline."""
    lens = Intrinsics(480, 360, 260.0, 260.0, 240.0, 180.0)  # 85 degrees wide
    turned = Rotation.from_euler("y", 48, degrees=True).as_matrix()  # from across the way towards its direction
    texture = cv2.GaussianBlur(np.random.default_rng(2).uniform(0, 255, (2000, 6000)).astype(np.float32), (0, 0), 4.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    wall_m, cameras, photos = 10.0, [], []
    for k in range(2):
        centre = np.array([1.5 * k, 0.0, 0.0])
        camera = Camera(f"{k}.jpg", lens, Similarity(1.0, turned.T, -turned.T @ centre))
        u, v = np.meshgrid(np.arange(480) + 0.5, np.arange(360) + 0.5)
        rays = lens.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation
        with np.errstate(divide="ignore"):
            hit = centre + rays * (wall_m / np.maximum(rays[:, 2:], 1e-6))
        x, y = ((hit[:, j] * 40 + offset).reshape(360, 480).astype(np.float32) for j, offset in ((0, 1000), (1, 1000)))
        grey = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderValue=128.0).astype(np.uint8)
        cameras.append(camera)
        photos.append(np.repeat(grey[..., None], 3, axis=2))
    assert (lens.rays(np.array([[480.0, 180.0]])) @ turned.T)[0, 2] < 0.2
    depth, _ = pair_depth(cameras[0], photos[0], cameras[1], photos[1], 4.0, 40.0, 3.0)
    u, v = np.meshgrid(np.arange(480) + 0.5, np.arange(360) + 0.5)
    towards_wall = (lens.rays(np.column_stack([u.ravel(), v.ravel()])) @ turned.T)[:, 2].reshape(360, 480)
    known = np.isfinite(depth)
    assert 0.2 < known.mean() < (towards_wall > 0.4).mean()
    assert np.median(np.abs(depth * towards_wall / wall_m - 1)[known]) < 0.01
