# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching against true depths, from true cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from flight import Flight, true_component, true_depth
from scene import PLAIN_ROOF
from skymoor.densify import SgmDepth
from skymoor.types import Camera, DepthMap, Photos

Array = NDArray[np.float64]
OBLIQUE, NADIR = range(12), range(12, 18)


@pytest.fixture(scope="module")
def maps(flight: Flight) -> list[DepthMap]:
    return SgmDepth()(true_component(flight), flight.photos)


@pytest.fixture(scope="module")
def truths(flight: Flight, maps: list[DepthMap]) -> list[Array]:
    return [true_depth(flight.scene, depth_map.camera).astype(np.float64) for depth_map in maps]


def surface(camera: Camera, depth: Array) -> Array:
    """World points (h, w, 3) of an undistorted depth map."""
    i = camera.intrinsics
    u, v = np.meshgrid(np.arange(i.width) + 0.5, np.arange(i.height) + 0.5)
    rays = i.rays(np.stack([u.ravel(), v.ravel()], axis=1)) @ camera.cam_from_world.rotation
    return (camera.centre + depth.reshape(-1, 1) * rays).reshape(i.height, i.width, 3)


def plain_pixels(camera: Camera, depth: Array) -> NDArray[np.bool_]:
    """Pixels a metre or more inside the roof that has no texture."""
    xyz = surface(camera, depth)
    return PLAIN_ROOF.inside(xyz[..., 0], xyz[..., 1], margin=1.0) & (xyz[..., 2] > 4)


def test_one_undistorted_map_per_photo(flight: Flight, maps: list[DepthMap]) -> None:
    assert [m.camera.image for m in maps] == list(flight.images)
    for depth_map in maps:
        assert not any(depth_map.camera.intrinsics.distortion)
        assert depth_map.rgb.shape == (*depth_map.depth.shape, 3) == (300, 400, 3)
        np.testing.assert_array_equal(np.isfinite(depth_map.depth), np.isfinite(depth_map.sigma))


def test_complete_and_accurate(maps: list[DepthMap], truths: list[Array]) -> None:
    errors = []
    for depth_map, truth in zip(maps, truths, strict=True):
        known = np.isfinite(depth_map.depth)
        assert known.mean() > 0.4
        error = (depth_map.depth[known] / truth[known]) - 1
        assert np.median(np.abs(error)) < 0.003
        errors.append(error)
    every = np.concatenate(errors)
    # Both sides: neither too near nor too far, and no better than a twentieth of a pixel's disparity can be.
    assert abs(np.median(every)) < 0.0004
    assert 0.0001 < np.median(np.abs(every)) < 0.001
    assert np.mean(np.abs(every) > 0.01) < 0.04


def test_sigma_says_how_wrong_depths_are(maps: list[DepthMap], truths: list[Array]) -> None:
    normalised = np.concatenate(
        [((m.depth - truth) / m.sigma)[np.isfinite(m.depth)] for m, truth in zip(maps, truths, strict=True)]
    )
    # The median of a normal distribution's absolute values is 0.67.
    assert 0.4 < np.median(np.abs(normalised)) < 1.0
    relative = np.concatenate([(m.sigma / m.depth)[np.isfinite(m.depth)] for m in maps])
    errors = np.concatenate([np.abs(m.depth / t - 1)[np.isfinite(m.depth)] for m, t in zip(maps, truths, strict=True)])
    order = np.argsort(relative)
    thirds = [errors[part].mean() for part in np.array_split(order, 3)]
    assert thirds[0] < thirds[1] < thirds[2]


def test_depths_from_above_are_more_certain_than_from_the_side(maps: list[DepthMap]) -> None:
    # Nearer, and at larger angles: the prediction must know the geometry.
    oblique = np.nanmedian(np.concatenate([maps[k].sigma.ravel() for k in OBLIQUE]))
    nadir = np.nanmedian(np.concatenate([maps[k].sigma.ravel() for k in NADIR]))
    assert nadir < oblique


def test_a_roof_without_texture_is_uncertain(maps: list[DepthMap], truths: list[Array]) -> None:
    for depth_map, truth in zip(maps, truths, strict=True):
        plain = plain_pixels(depth_map.camera, truth)
        known = plain & np.isfinite(depth_map.depth)
        if known.sum() > 200:
            rest = np.isfinite(depth_map.depth) & ~plain
            assert np.median(depth_map.sigma[known]) > 20 * np.median(depth_map.sigma[rest])


def test_smaller_maps_are_coarser_but_right(flight: Flight, truths: list[Array]) -> None:
    component = true_component(flight)
    (small, *_) = SgmDepth(max_px=200)(component, flight.photos)
    assert small.depth.shape == (150, 200)
    assert small.camera.intrinsics == component.cameras[0].intrinsics.resized(200, 150).undistorted()
    truth = true_depth(flight.scene, small.camera)
    error = (small.depth / truth - 1)[np.isfinite(small.depth)]
    assert abs(np.median(error)) < 0.001 and np.median(np.abs(error)) < 0.003


def test_photos_without_partners_give_no_map(flight: Flight) -> None:
    component = true_component(flight)
    lonely = replace(component, cameras=component.cameras[:2], obs_camera=component.obs_camera[:1] * 0)
    lonely = replace(lonely, obs_point=component.obs_point[:1], obs_px=component.obs_px[:1])
    photos = Photos(flight.photos.names[:2], flight.photos.sizes[:2], flight.photos.read)
    assert SgmDepth()(lonely, photos) == []
