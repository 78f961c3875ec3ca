# SPDX-License-Identifier: Apache-2.0
"""Known up, hidden by a turn, must be found again from points and cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.orient import estimate_gravity, level_from_gravity
from skymoor.types import Array, Camera, Component, Gravity
from support.blocks import LENS, ground_points, look_at, observed, ring, strips

HIDDEN = Similarity(0.37, Rotation.from_euler("zyx", [40, -115, 70], degrees=True).as_matrix(), [3.0, -8.0, 2.0])
UP = HIDDEN.rotation[:, 2]
SIDEWAYS = Rotation.from_euler("z", 90, degrees=True).as_matrix()


def hidden(cameras: list[Camera], points: Array) -> Component:
    return observed(cameras, points, noise_px=0.2).transformed(HIDDEN)


def found(component: Component) -> Gravity:
    return estimate_gravity(component, rng=np.random.default_rng(0))


def error_deg(gravity: Gravity) -> float:
    assert np.linalg.norm(gravity.up) == pytest.approx(1.0)
    return float(np.degrees(np.arccos(np.clip(gravity.up @ UP, -1, 1))))


def turned(camera: Camera, turn: Array) -> Camera:
    """The photo stored turned about its axis."""
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Similarity(1.0, turn @ pose.rotation, turn @ pose.translation))


def test_with_parallel_azimuths_the_plane_decides() -> None:
    gravity = found(hidden(strips(), ground_points(800, relief_m=0.5)))
    assert error_deg(gravity) < 0.6
    assert gravity.method == "plane"
    assert np.isnan(gravity.disagreement_deg)


@pytest.mark.parametrize(("heading_deg", "low_deg", "high_deg"), [(0, 0.0, 1.0), (90, 2.0, 3.5)])
def test_parallel_azimuths_detect_a_slope_across_but_not_along(
    heading_deg: float, low_deg: float, high_deg: float
) -> None:
    # The slope runs to the east: a roll of all photos that head north, a pitch of those that head east.
    gravity = found(hidden(strips(heading_deg=heading_deg), ground_points(800, relief_m=0.5, slope_deg=3.0)))
    assert low_deg < error_deg(gravity) < high_deg
    assert 1.5 < gravity.sigma_deg < 2.5


@pytest.mark.parametrize("slope_deg", [0.0, 3.0, -5.0])
def test_cameras_all_around_decide_though_the_terrain_slopes(slope_deg: float) -> None:
    gravity = found(hidden(ring(), ground_points(800, relief_m=0.5, slope_deg=slope_deg)))
    assert error_deg(gravity) < 0.5
    assert "cameras" in gravity.method
    assert gravity.disagreement_deg == pytest.approx(abs(slope_deg), abs=0.5)
    assert 0.1 < gravity.sigma_deg < 0.6


def test_sigma_covers_the_error_over_many_trials() -> None:
    normalised = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        cameras = [
            Camera(str(k), LENS, look_at(c, np.zeros(3), roll_deg=rng.normal(scale=1.5)))
            for k, c in enumerate(camera.centre for camera in ring())
        ]
        points = ground_points(300, relief_m=0.5, slope_deg=rng.normal(scale=2.0), seed=seed)
        gravity = found(hidden(cameras, points))
        normalised.append(error_deg(gravity) / gravity.sigma_deg)
    # The error has two directions: the root mean square is about 1.4 where sigma is right.
    assert 0.3 < np.sqrt(np.mean(np.square(normalised))) < 1.8


def test_a_roll_that_all_cameras_share_cancels_around_the_ring() -> None:
    gravity = found(hidden(ring(common_roll_deg=3.0), ground_points(800, relief_m=0.5, slope_deg=3.0)))
    # Each photo is less trusted, so the sloping plane gets a little weight.
    assert error_deg(gravity) < 1.0
    assert gravity.sigma_deg > 0.6


@pytest.mark.parametrize("turn", [SIDEWAYS, SIDEWAYS.T], ids=["left", "right"])
@pytest.mark.parametrize("share", [1 / 3, 2 / 3, 1.0])
def test_portrait_photos_stored_sideways_do_not_mislead(turn: Array, share: float) -> None:
    cameras = [turned(camera, turn) if (k % 3) / 3 < share else camera for k, camera in enumerate(ring())]
    gravity = found(hidden(cameras, ground_points(800, relief_m=0.5, slope_deg=3.0)))
    assert error_deg(gravity) < 0.5


def test_photos_stored_upside_down_do_not_mislead() -> None:
    cameras = [turned(camera, SIDEWAYS @ SIDEWAYS) if k % 2 else camera for k, camera in enumerate(ring())]
    gravity = found(hidden(cameras, ground_points(800, relief_m=0.5, slope_deg=3.0)))
    assert error_deg(gravity) < 0.5


def test_one_photo_with_a_wild_roll_is_outvoted() -> None:
    cameras = ring()
    cameras[5] = turned(cameras[5], Rotation.from_euler("z", 17, degrees=True).as_matrix())
    gravity = found(hidden(cameras, ground_points(800, relief_m=0.5, slope_deg=3.0)))
    assert error_deg(gravity) < 0.6


def test_up_is_where_the_rays_come_from() -> None:
    """Also for cameras near the ground whose axes look slightly upwards: rays to what they see count, not axes."""
    rng = np.random.default_rng(5)
    cameras = []
    for k, azimuth in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False)):
        outwards = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        centre = 12 * outwards + [0, 0, 2.0]
        pose = look_at(centre, centre - 10 * outwards + [0, 0, 0.5], roll_deg=rng.normal(scale=0.5))
        cameras.append(Camera(f"{k}", LENS, pose))
        assert pose.rotation[2, 2] > 0
    for mirror in (np.eye(3), np.diag([1.0, -1.0, -1.0])):  # a half turn: nothing in the frame itself says where up is
        frame = Similarity(2.0, mirror, np.zeros(3))
        gravity = found(observed(cameras, ground_points(900, relief_m=0.1, extent_m=25)).transformed(frame))
        assert gravity.up @ mirror[:, 2] > 0.999


def test_points_off_the_ground_do_not_tilt_it() -> None:
    rng = np.random.default_rng(6)
    ground = ground_points(600, relief_m=0.3)
    roofs = rng.uniform([5, -40, 6], [40, 40, 12], (200, 3))
    stray = rng.uniform([-45, -45, -40], [45, 45, 30], (150, 3))
    gravity = found(hidden(strips(), np.concatenate([ground, roofs, stray])))
    assert error_deg(gravity) < 0.8
    assert gravity.camera_height / HIDDEN.scale == pytest.approx(60, abs=1.5)


@pytest.mark.parametrize("slope_deg", [0.0, 3.0])
def test_level_frame(slope_deg: float) -> None:
    component = hidden(ring(), ground_points(800, relief_m=1.0, slope_deg=slope_deg))
    gravity = found(component)
    level_from_sfm = level_from_gravity(component, gravity)
    level = component.transformed(level_from_sfm)
    np.testing.assert_allclose(level_from_sfm.rotation @ gravity.up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(level.centres[:, :2].mean(axis=0), 0, atol=1e-12)
    assert np.median(level.centres[:, 2]) == pytest.approx(1.0)
    assert abs(np.median(level.points[:, 2])) < 0.02
    # One unit is the flying height: 60 m over ground that is half a metre high.
    assert (level_from_sfm @ HIDDEN).scale == pytest.approx(1 / 59.5, rel=0.01)


def test_points_on_a_line_are_refused() -> None:
    line = np.column_stack([np.linspace(-30, 30, 100), np.zeros(100), np.zeros(100)])
    with pytest.raises(DegenerateGeometry):
        found(hidden(ring(), line))


def test_two_points_are_refused() -> None:
    with pytest.raises(DegenerateGeometry):
        found(hidden(ring(), ground_points(2, relief_m=0.0, extent_m=5)))
