# SPDX-License-Identifier: Apache-2.0
"""Known up, hidden by a turn, must be found again from the upright edges of a wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.orient import UprightOptions, estimate_ground_gravity, level_from_gravity
from skymoor.types import Camera, Component, Gravity, Image, Mask, Photos
from support.walks import EYE_M, WALL_M, reconstructed, walk, wall_points, watchers

Array = NDArray[np.float64]

HIDDEN = Similarity(0.37, Rotation.from_euler("zyx", [40, -115, 70], degrees=True).as_matrix(), [3.0, -8.0, 2.0])
UP = HIDDEN.rotation[:, 2]
LEFT, RIGHT, OVER = (Rotation.from_euler("z", deg, degrees=True).as_matrix() for deg in (90, -90, 180))


def windows(lean_deg: float = 0.0) -> Array:
    """Outlines (n, m, 3) of windows in the wall, whose sides lean to the left."""
    t = np.linspace(0, 1, 9)[:, None]
    corners = np.array([[0.0, 0.0], [1.2, 0.0], [1.2, 1.5], [0.0, 1.5]])
    outline = np.concatenate([a + t * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    outline[:, 0] -= np.tan(np.radians(lean_deg)) * outline[:, 1]
    places = np.array([[x, z] for x in np.arange(0.5, WALL_M - 1, 2.5) for z in (1.0, 4.0)])
    plan = outline + places[:, None]
    return np.stack([plan[..., 0], np.zeros_like(plan[..., 0]), plan[..., 1]], axis=-1)


def photo(camera: Camera, outlines: Array) -> Image:
    """Dark windows in a light wall."""
    i = camera.intrinsics
    image = np.full((i.height, i.width), 190, np.uint8)
    for outline in outlines:
        px = i.px_from_cam(camera.cam_from_world.apply(outline)) - 0.5
        if np.isfinite(px).all():
            cv2.fillPoly(image, [np.round(px * 16).astype(np.int32)], 60, cv2.LINE_AA, 4)
    noise = np.random.default_rng(len(camera.image)).normal(scale=2.0, size=image.shape)
    return np.repeat(np.clip(image + noise, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def blank(camera: Camera) -> Image:
    return np.full((camera.intrinsics.height, camera.intrinsics.width, 3), 128, np.uint8)


def photos_of(images: dict[str, Image]) -> Photos:
    sizes = tuple((image.shape[1], image.shape[0]) for image in images.values())
    return Photos(tuple(images), sizes, images.__getitem__)


def turned(camera: Camera, turn: Array) -> Camera:
    """The photo stored turned about its axis."""
    i, pose = camera.intrinsics, camera.cam_from_world
    if abs(turn[0, 0]) < 0.5:
        i = replace(i, width=i.height, height=i.width, cx=i.cy, cy=i.cx)
    return replace(camera, intrinsics=i, cam_from_world=Similarity(1.0, turn @ pose.rotation, turn @ pose.translation))


def found(
    cameras: Sequence[Camera],
    *,
    lean_deg: float = 0.0,
    edges: bool = True,
    points: Array | None = None,
    options: UprightOptions | None = None,
    ground: Mask | None = None,
) -> tuple[Gravity, Component]:
    component = reconstructed(cameras, wall_points() if points is None else points).transformed(HIDDEN)
    outlines = windows(lean_deg)
    images = {camera.image: photo(camera, outlines) if edges else blank(camera) for camera in cameras}
    return estimate_ground_gravity(component, photos_of(images), options, ground=ground), component


def error_deg(gravity: Gravity) -> float:
    assert np.linalg.norm(gravity.up) == pytest.approx(1.0)
    return float(np.degrees(np.arccos(np.clip(gravity.up @ UP, -1, 1))))


def test_upright_edges_determine_up_for_any_roll() -> None:
    gravity, _ = found([*walk(roll_deg=3.0), *watchers()])
    assert error_deg(gravity) < 0.15
    assert 0.1 < gravity.sigma_deg < 0.3
    assert "upright edges" in gravity.method


def test_without_edges_it_is_as_good_as_the_cameras_are_held() -> None:
    options = UprightOptions(roll_deg=2.0)
    gravity, _ = found(walk(12, roll_deg=2.0), edges=False, options=options)
    assert 0.2 < error_deg(gravity) < 4.0
    assert 0.5 < gravity.sigma_deg < 4.0
    assert gravity.method == "12 cameras held level"
    assert gravity.disagreement_deg == pytest.approx(0.0, abs=1e-3)


def test_a_common_lean_is_not_detected() -> None:
    gravity, _ = found(walk(roll_deg=1.0), lean_deg=2.0)
    assert error_deg(gravity) == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize(("turn", "every"), [(LEFT, 1), (RIGHT, 1), (LEFT, 2), (OVER, 3)])
def test_photos_stored_on_their_side_or_head_do_not_mislead(turn: Array, every: int) -> None:
    cameras = [turned(camera, turn) if k % every == 0 else camera for k, camera in enumerate(walk())]
    gravity, _ = found(cameras)
    assert error_deg(gravity) < 0.15


def test_one_photo_with_a_wild_roll_is_outvoted() -> None:
    cameras = walk()
    cameras[4] = turned(cameras[4], Rotation.from_euler("z", 25, degrees=True).as_matrix())
    assert error_deg(found(cameras)[0]) < 0.15


def test_three_photos_are_enough() -> None:
    assert error_deg(found(walk(3, along_m=(6.0, 14.0)))[0]) < 0.3


def test_the_lowest_points_near_by_are_the_ground() -> None:
    gravity, component = found(walk())
    assert gravity.camera_height / HIDDEN.scale == pytest.approx(EYE_M, abs=0.15)
    level = component.transformed(level_from_gravity(component, gravity))
    assert np.median(level.centres[:, 2]) == pytest.approx(1.0)
    assert np.percentile(level.points[:, 2], 1) == pytest.approx(0.0, abs=0.02)


def test_where_no_ground_is_seen_a_usual_height_is_taken() -> None:
    points = wall_points(1500)
    gravity, _ = found(walk(), points=points[points[:, 2] > EYE_M])
    assert "no ground in sight" in gravity.method
    assert 1.0 < gravity.camera_height / HIDDEN.scale < 2.5


def test_two_cameras_are_refused() -> None:
    with pytest.raises(DegenerateGeometry):
        found(walk(2, along_m=(8.0, 12.0)))


def test_labelled_ground_determines_the_camera_height() -> None:
    """Where a bed of flowers hides the foot of the wall, the lowest points are not the ground; labels know better."""
    rng = np.random.default_rng(3)
    wall = wall_points(1200)
    lawn = np.column_stack([rng.uniform(0, WALL_M, 150), rng.uniform(-3, -1, 150), np.zeros(150)])
    pit = np.column_stack([rng.uniform(0, WALL_M, 60), rng.uniform(-3, -1, 60), np.full(60, -1.0)])
    points = np.concatenate([wall[wall[:, 2] > 0.5], lawn, pit])
    guessed, component = found(walk(), points=points)
    at = HIDDEN.inverse().apply(component.points)
    labels = np.asarray(np.abs(at[:, 2]) < 0.05)
    assert 40 < labels.sum() <= 150
    known, _ = found(walk(), points=points, ground=labels)
    assert guessed.camera_height / HIDDEN.scale > EYE_M + 0.5
    assert known.camera_height / HIDDEN.scale == pytest.approx(EYE_M, abs=0.15)
    assert known.method.endswith("upright edges, on labelled ground")
    few = labels & (np.cumsum(labels) <= 10)
    assert found(walk(), points=points, ground=few)[0].plane_height == guessed.plane_height
    above = np.asarray(at[:, 2] > EYE_M + 0.5)
    assert found(walk(), points=points, ground=above)[0].plane_height == guessed.plane_height
