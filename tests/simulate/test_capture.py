# SPDX-License-Identifier: Apache-2.0
"""Where simulated photos are taken from: far enough, steep enough, connected, and with nothing before the lens."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.simulate.capture.aim import looking
from skymoor.simulate.capture.footing import circuit_round, clear_views, free_places, ground_up, within_buildings
from skymoor.simulate.capture.shots import STANDOFF_M, Shot, airborne_shots, ground_shots, security_shots, true_view
from skymoor.simulate.capture.walks import walk_of
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import dates_of, place_of
from skymoor.simulate.world import World

Array = NDArray[np.float64]
MakeWorld = Callable[..., World]


def centres(shots: list[Shot]) -> Array:
    return np.array([shot.camera.centre for shot in shots])


def pitches_deg(shots: list[Shot]) -> Array:
    """Of the optical axes, upwards positive."""
    return np.asarray(np.degrees(np.arcsin([shot.camera.cam_from_world.rotation[2, 2] for shot in shots])))


def rolls_deg(shots: list[Shot]) -> Array:
    rows = np.array([shot.camera.cam_from_world.rotation for shot in shots])
    return np.asarray(np.degrees(np.arctan2(rows[:, 0, 2], -rows[:, 1, 2])))


def is_nadir(shots: list[Shot]) -> NDArray[np.bool_]:
    return pitches_deg(shots) < -75


@pytest.mark.parametrize("preset", sorted(STANDOFF_M))
def test_flights_keep_the_preset_s_standoff_and_look_down_steeply(make_world: MakeWorld, preset: str) -> None:
    shots = airborne_shots(make_world(preset=preset, airborne=50, radius_m=85.0, seed=3))
    assert len(shots) == 50 and 14 <= is_nadir(shots).sum() <= 20
    standoff = np.linalg.norm(centres(shots), axis=1).mean()
    assert standoff == pytest.approx(STANDOFF_M[preset], rel=0.05)
    assert pitches_deg(shots).max() < -44.5
    oblique = centres(shots)[~is_nadir(shots)]
    azimuths = np.sort(np.degrees(np.arctan2(oblique[:, 0], oblique[:, 1])))
    assert np.diff(azimuths, append=azimuths[0] + 360).max() < 2 * 360 / 24


@pytest.mark.parametrize("radius_m", [45.0, 85.0])
def test_nobody_flies_into_a_hill(radius_m: float) -> None:
    for seed in range(4):
        world = World(SiteOptions(preset="hillside", seed=seed, radius_m=radius_m))
        eyes = centres(airborne_shots(world))
        assert (eyes[:, 2] - ground_up(world, eyes[:, :2])).min() > 0.8 * 95 * radius_m / 85


def test_one_lens_flies_and_its_middle_is_off(make_world: MakeWorld) -> None:
    shots = airborne_shots(make_world(photo_width=1000))
    (lens,) = {shot.camera.intrinsics for shot in shots}
    off = np.hypot(lens.cx - 500, lens.cy - 375)
    assert 3.0 <= off <= 4.5 and lens.fx == pytest.approx(865, rel=0.011) and lens.max_radius > 1
    exposures = np.array([shot.sensor.exposure for shot in shots])
    assert 0.005 < exposures.std() < 0.1


def test_names_say_nothing_about_the_order_of_flight(make_world: MakeWorld) -> None:
    shots = airborne_shots(make_world(airborne=50, radius_m=85.0))
    assert [shot.camera.image for shot in shots] == [f"airborne/air_{k:03d}.jpg" for k in range(50)]
    apart = np.linalg.norm(np.diff(centres(shots), axis=0), axis=1)
    every = np.linalg.norm(centres(shots)[:, None] - centres(shots), axis=2)
    assert np.median(apart) > 0.7 * np.median(every)


def test_a_dozen_photos_hang_together(make_world: MakeWorld) -> None:
    shots = airborne_shots(make_world(airborne=12))
    assert is_nadir(shots).sum() == 4
    grid = np.stack(np.meshgrid(np.arange(-60, 61, 2.0), np.arange(-60, 61, 2.0), [0.0]), axis=-1).reshape(-1, 3)
    seen = []
    for shot in shots:
        i = shot.camera.intrinsics
        px = i.px_from_cam(shot.camera.cam_from_world.apply(grid))
        seen.append((px > 0).all(axis=1) & (px < [i.width, i.height]).all(axis=1))
    both = np.array([[np.count_nonzero(a & b) / min(a.sum(), b.sum()) for b in seen] for a in seen])
    axes = np.array([shot.camera.cam_from_world.rotation[2] for shot in shots])
    angle = np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))
    partners = (both > 0.5) & (angle < 40)
    assert (partners.sum(axis=1) - 1 >= 3).all()
    reach = np.linalg.matrix_power(partners.astype(np.int64), len(shots)) > 0
    assert reach.all()


def test_walkers_keep_their_distance_and_their_feet_on_the_ground(make_world: MakeWorld) -> None:
    world = make_world(group_photos=11)
    shots = ground_shots(world)
    assert [shot.group for shot in shots] == ["a"] * 11 + ["b"] * 11
    for letter, name in zip("ab", world.plan.walked, strict=True):
        group = [shot for shot in shots if shot.group == letter]
        outline = next(b for b in world.plan.buildings if b.name == name).outline_enu.astype(np.float32)
        plan = centres(group)[:, :2]
        gap = [-cv2.pointPolygonTest(outline, (float(e), float(n)), True) for e, n in plan]
        assert min(gap) > 7.5 and max(gap) < 13.6 and np.std(gap) > 0.1
        eyes = centres(group)[:, 2] - ground_up(world, plan)
        assert eyes.min() > 1.3 and eyes.max() < 2.3 and eyes.std() > 0.01
        apart = np.linalg.norm(plan[:, None] - plan, axis=2) + 1e3 * np.eye(len(plan))
        assert apart.min(axis=1).min() > 1.5 and apart.min(axis=1).max() < 6.0
        assert len({shot.camera.intrinsics for shot in group}) == 1
    assert shots[0].camera.intrinsics != shots[-1].camera.intrinsics


def test_hands_are_not_quite_level(make_world: MakeWorld) -> None:
    shots = ground_shots(make_world(groups=1, group_photos=35))
    assert 1.2 < rolls_deg(shots).std() < 3.0 and abs(rolls_deg(shots).mean()) < 1.5
    assert 2 < pitches_deg(shots).mean() < 14


def test_many_photos_go_all_the_way_round(make_world: MakeWorld) -> None:
    world = make_world(groups=1, group_photos=45)
    building = next(b for b in world.plan.buildings if b.name == world.plan.walked[0])
    around = centres(ground_shots(world))[:, :2] - [building.east, building.north]
    azimuths = np.sort(np.degrees(np.arctan2(around[:, 0], around[:, 1])))
    assert np.diff(azimuths, append=azimuths[0] + 360).max() < 60


def test_every_ground_photo_shows_a_building_and_nothing_stands_before_it(make_world: MakeWorld) -> None:
    world = make_world(group_photos=11, security=6)
    scene = world.scene(dates_of(world.options).ground)
    for shot in (*ground_shots(world), *security_shots(world)):
        pose = shot.camera.cam_from_world
        centre = shot.camera.centre[None]
        lens, share = shot.camera.intrinsics, 0.15
        assert clear_views(scene, lens, centre, pose.rotation[None], wall_share=share)[0], shot.camera.image
        assert not within_buildings(world, centre[:, :2], margin_m=0.1)[0]


def test_what_blocks_a_place(world: World) -> None:
    scene = world.scene(dates_of(world.options).ground)
    building, tree = world.plan.buildings[0], world.plan.trees[0]
    outward = np.array([-np.sin(np.radians(building.heading_deg)), np.cos(np.radians(building.heading_deg))])
    middle = np.array([building.east, building.north])
    plan = np.array([[10.0, 5.0], middle, middle + 6.3 * outward, middle + 16 * outward, tree[:2] + 0.4, [900, 900]])
    eyes = np.column_stack([plan, ground_up(world, plan) + 1.6])
    assert free_places(world, scene, eyes).tolist() == [True, False, False, True, False, False]
    assert not free_places(world, scene, eyes[:1] + [0, 0, 2.0])[0]  # nobody is that tall


def test_what_blocks_a_view(world: World) -> None:
    scene = world.scene(dates_of(world.options).ground)
    lens = walk_of(world, 0).lens
    circuit = circuit_round(world.plan.buildings[0].outline_enu)
    near, far = (circuit.places([d])[0] for d in (0.9, 10.0))
    inward = np.degrees(np.arctan2(-circuit.outward[0, 0], -circuit.outward[0, 1]))
    eyes = np.column_stack([np.concatenate([near, far, far]), [1.0, 1.0, 1.0]])
    assert clear_views(scene, lens, eyes, looking([inward, inward, inward + 180], 3.0)).tolist() == [False, True, False]


def test_a_circuit_keeps_its_distance_also_in_a_recess() -> None:
    outline = np.array([(0, 0), (60, 0), (60, 30), (40, 30), (40, 12), (15, 12), (15, 30), (0, 30)], float) + [200, -50]
    circuit = circuit_round(outline)
    path = circuit.places([10.0])[:, 0]
    gap = np.array([-cv2.pointPolygonTest(outline.astype(np.float32), (float(e), float(n)), True) for e, n in path])
    assert np.abs(gap - 10).max() < 0.8
    steps = np.roll(path, -1, axis=0) - path
    assert np.linalg.norm(steps, axis=1).min() > 0.3 and np.linalg.norm(steps, axis=1).max() < 1.1
    after = np.roll(path, -1, axis=0)
    assert np.sum(path[:, 0] * after[:, 1] - path[:, 1] * after[:, 0]) > 0


def test_security_cameras_look_down_from_above_with_lenses_that_can_be_undone(make_world: MakeWorld) -> None:
    world = make_world(security=8, photo_width=1000)
    shots = security_shots(world)
    assert pitches_deg(shots).min() > -25.1 and pitches_deg(shots).max() < -9.9
    up = centres(shots)[:, 2] - ground_up(world, centres(shots)[:, :2])
    assert up.min() > 2.9 and up.max() < 5.1
    apart = np.linalg.norm(centres(shots)[:, None] - centres(shots), axis=2) + 1e3 * np.eye(8)
    assert apart.min() > 2.0
    lenses = [shot.camera.intrinsics for shot in shots]
    assert len(set(lenses)) == 8
    for lens in lenses:
        assert -0.28 <= lens.distortion[0] <= -0.10 and lens.max_radius == np.inf
        corners = np.array([[0, 0], [1000, 0], [1000, 750], [0, 750], [500, 375]], float)
        np.testing.assert_allclose(lens.px_from_cam(lens.rays(corners)), corners, atol=1e-5)
    assert sorted(shot.camera.image for shot in shots) == [f"ground/security_{k:03d}.jpg" for k in range(8)]


def test_one_set_does_not_depend_on_another(make_world: MakeWorld) -> None:
    base = ground_shots(make_world())
    other = ground_shots(make_world(security=0, airborne=9))
    for a, b in zip(base, other, strict=True):
        assert a.camera.image == b.camera.image and a.sensor == b.sensor
        np.testing.assert_array_equal(a.camera.centre, b.camera.centre)
    assert not np.allclose(centres(base), centres(ground_shots(make_world(seed=1))))


@pytest.mark.parametrize(
    ("options", "words"),
    [({"groups": 3}, "groups = 3"), ({"group_photos": 400}, "400"), ({"security": 400, "groups": 1}, "security = 400")],
)
def test_what_does_not_fit_is_refused(make_world: MakeWorld, options: dict[str, int], words: str) -> None:
    with pytest.raises(InputError, match=words):
        _ = [*ground_shots(make_world(**options)), *security_shots(make_world(**options))]


def test_truth_is_found_by_name(world: World) -> None:
    shot = ground_shots(world)[2]
    camera, scene = true_view(world, shot.camera.image)
    np.testing.assert_array_equal(camera.centre, shot.camera.centre)
    assert scene is world.scene(dates_of(world.options).ground)
    with pytest.raises(InputError, match=r"air_999\.jpg"):
        true_view(world, "airborne/air_999.jpg")


def test_the_sun_goes_through_the_right_side_of_the_sky(make_world: MakeWorld) -> None:
    options = [make_world(seed=seed).options for seed in range(24)]
    southern = np.array([place_of(o).lat_deg < 0 for o in options])
    assert 0 < southern.sum() < len(options)
    for o, south in zip(options, southern, strict=True):
        dates = dates_of(o)
        for date in (dates.airborne, dates.satellite):
            assert (date.sun[1] > 0) == south
        assert dates.airborne.season == dates.ground.season == "summer" != dates.satellite.season
        assert 20 < place_of(o).height_m < 300
        assert dates.airborne.sun[0] > 0 > dates.ground.sun[0]  # morning and afternoon
