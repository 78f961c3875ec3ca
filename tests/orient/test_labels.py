# SPDX-License-Identifier: Apache-2.0
"""A street: a wall with many points before the cameras, and a little ground at their feet."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geometry import Similarity
from skymoor.orient import GroundLabeler, estimate_gravity, ground_points
from skymoor.types import Array, Camera, Component, Image, Mask, Photos
from support.blocks import LENS, look_at, observed

WALL_M, EYE_M = 12.0, 1.6


def brightness(image: Image) -> Mask:
    return np.asarray(image[..., 0] > 127)


LABELER: GroundLabeler = brightness


@pytest.fixture
def cameras() -> list[Camera]:
    """Side by side, all with one heading: their horizon alone leaves the pitch open."""
    rng = np.random.default_rng(2)
    centres = [np.array([east, 0.0, EYE_M]) for east in np.linspace(-9, 9, 8)]
    return [
        Camera(f"{k}.jpg", LENS, look_at(centre, centre + [0, WALL_M, 0.6], roll_deg=rng.normal(scale=0.5)))
        for k, centre in enumerate(centres)
    ]


@pytest.fixture
def component(cameras: list[Camera]) -> Component:
    rng = np.random.default_rng(3)
    wall = np.column_stack([rng.uniform(-14, 14, 1500), np.full(1500, WALL_M), rng.uniform(0.5, 8, 1500)])
    ground = np.column_stack([rng.uniform(-9, 9, 60), rng.uniform(6.5, WALL_M, 60), np.zeros(60)])
    return observed(cameras, np.concatenate([wall, ground]), noise_px=0.2)


@pytest.fixture
def photos(cameras: list[Camera]) -> Photos:
    """White where a ray meets the ground before the wall."""
    u, v = np.meshgrid(np.arange(LENS.width) + 0.5, np.arange(LENS.height) + 0.5)
    rays = LENS.rays(np.column_stack([u.ravel(), v.ravel()]))
    images = {}
    for camera in cameras:
        d = rays @ camera.cam_from_world.rotation
        with np.errstate(divide="ignore"):
            ground = (d[:, 2] < 0) & (-EYE_M / d[:, 2] * d[:, 1] < WALL_M)
        white = np.where(ground, 255, 0).astype(np.uint8).reshape(LENS.height, LENS.width, 1)
        images[camera.image] = np.repeat(white, 3, axis=2)
    return Photos(tuple(images), ((LENS.width, LENS.height),) * len(images), images.__getitem__)


def error_deg(component: Component, ground: Mask | None) -> float:
    up: Array = estimate_gravity(component, rng=np.random.default_rng(0), ground=ground).up
    return float(np.degrees(np.arccos(np.clip(up[2], -1, 1))))


def test_marked_points_are_the_ground(component: Component, photos: Photos) -> None:
    marked = ground_points(component, photos, LABELER)
    truth = component.points[:, 2] < 1e-9
    seen = np.bincount(component.obs_point, minlength=len(truth)) > 0
    assert truth[seen].sum() > 20
    assert (marked == truth)[seen].mean() > 0.99


def test_the_ground_decides_where_a_wall_has_most_points(component: Component, photos: Photos) -> None:
    marked = ground_points(component, photos, LABELER)
    assert error_deg(component, None) > 30  # the wall passes for the ground
    assert error_deg(component, marked) < 1.5


def test_too_few_marks_change_nothing(component: Component) -> None:
    few = component.points[:, 2] < 1e-9
    few &= np.cumsum(few) <= 5
    assert error_deg(component, few) == error_deg(component, None)


def test_it_works_in_any_frame(component: Component, photos: Photos) -> None:
    turn = Similarity(0.3, np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.array([4.0, 5, 6]))
    moved = component.transformed(turn)
    up = estimate_gravity(moved, rng=np.random.default_rng(0), ground=ground_points(moved, photos, LABELER)).up
    assert np.degrees(np.arccos(up @ turn.rotation[:, 2])) < 1.5
