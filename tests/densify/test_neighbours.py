# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skymoor.densify.neighbours import depth_range, stereo_partners
from skymoor.types import Camera, Component
from support.blocks import LENS, look_at, observed
from support.flight import Flight, true_component

Array = NDArray[np.float64]


def component_at(centres: Array, *, points: int = 200) -> Component:
    """Cameras that all look down at the same points near the origin."""
    xyz = np.random.default_rng(0).uniform([-10, -10, -1], [10, 10, 1], (points, 3))
    poses = [look_at(centre, np.zeros(3), up=np.array([0, 1.0, 0])) for centre in centres]
    return observed([Camera(f"{k}", LENS, pose) for k, pose in enumerate(poses)], xyz)


def at_angles(angles_deg: list[float], azimuths_deg: list[float]) -> Array:
    """Centres 100 away from the origin, so many degrees off the vertical."""
    a, z = np.radians(angles_deg), np.radians(azimuths_deg)
    return 100 * np.stack([np.sin(a) * np.cos(z), np.sin(a) * np.sin(z), np.cos(a)], axis=1)


def test_the_wanted_angle_comes_first_and_too_wide_ones_never() -> None:
    component = component_at(at_angles([0, 3, 14, 30, 50], [0] * 5))
    partners = stereo_partners(component, count=4, best_angle_deg=14, max_angle_deg=35)
    assert partners[0][0] == 2
    assert 4 not in partners[0]
    assert set(partners[4]) == {3}
    assert all(k not in chosen for k, chosen in enumerate(partners))


def test_partners_in_different_directions_beat_a_row() -> None:
    # Three in one direction at good angles, and one across at an angle that is a little worse than all of them.
    component = component_at(at_angles([0, 13, 14, 15, 18], [0, 0, 0, 0, 90]))
    partners = stereo_partners(component, count=2, best_angle_deg=14, max_angle_deg=35)
    assert partners[0][0] in (1, 2, 3)
    assert partners[0][1] == 4


def test_cameras_that_share_too_little_have_no_partners() -> None:
    component = component_at(at_angles([0, 14], [0, 0]), points=20)
    assert stereo_partners(component, count=2, best_angle_deg=14, max_angle_deg=35) == [[], []]


def test_angles_of_a_real_flight(flight: Flight) -> None:
    component = true_component(flight)
    partners = stereo_partners(component, count=4, best_angle_deg=14, max_angle_deg=35)
    assert min(map(len, partners)) >= 2
    middles = [
        component.points[component.obs_point[component.obs_camera == k]].mean(axis=0)
        for k in range(len(flight.cameras))
    ]
    for k, chosen in enumerate(partners):
        a = component.centres[k] - middles[k]
        for partner in chosen:
            b = component.centres[partner] - middles[k]
            angle = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
            assert 8 < angle < 35


def test_depth_range_holds_what_is_seen_and_little_more(flight: Flight) -> None:
    component = true_component(flight)
    for k, camera in enumerate(component.cameras):
        near, far = depth_range(component, k)
        mine = component.points[component.obs_point[component.obs_camera == k]]
        depth = camera.cam_from_world.apply(mine)[:, 2]
        assert near > 0 and np.mean(depth > near) > 0.999
        assert np.mean(depth < far) > 0.97
        assert near > 0.5 * depth.min()
        assert far < 1.6 * np.percentile(depth, 98)
