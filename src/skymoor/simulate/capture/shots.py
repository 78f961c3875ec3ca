# SPDX-License-Identifier: Apache-2.0
"""Who takes the photos of a simulated site: from where, with which lens, and how well."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geometry import Intrinsics, Similarity
from skymoor.simulate.capture.aim import looking, make_lens, standing_at
from skymoor.simulate.capture.carriers import carrier_of, sensors_of
from skymoor.simulate.capture.footing import ground_up
from skymoor.simulate.capture.grid import grid_poses
from skymoor.simulate.capture.real_walks import real_walk_of
from skymoor.simulate.capture.walks import walk_of, watching
from skymoor.simulate.light.motion import STILL, Motion
from skymoor.simulate.light.photo import Sensor
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import stream
from skymoor.simulate.plan import dates_of
from skymoor.simulate.world import World
from skymoor.types import Camera

Array = NDArray[np.float64]

# Mean distance of the airborne cameras to the middle of the site; of the first three as in the paper's results.
STANDOFF_M = {"office-park": 148.0, "industrial": 113.0, "flooded": 67.0, "hillside": 150.0, "old-houses": 140.0}
FULL_RADIUS_M = 85.0  # smaller sites are flown lower
NADIR_SHARE = 0.35


@dataclass(frozen=True, eq=False)
class Shot:
    """A photo to be taken: its camera in the site's frame, named by its file relative to the site's folder.

    `set` is "airborne" or "ground"; `group` is the letter of a walk, or "security", or empty. `piece` numbers the
    pieces of a walk with gaps.
    """

    camera: Camera
    sensor: Sensor
    set: str
    group: str = ""
    motion: Motion = STILL
    piece: int = 0


def airborne_shots(world: World) -> list[Shot]:
    """A grid, or strips that look down and rings at 45 degrees or steeper; one camera for all."""
    options = world.options
    rng = stream(options.key, "airborne")
    lens = make_lens(options, rng, 0.865 * float(rng.uniform(0.99, 1.01)), (-0.045, 0.012, 0.0, 0.0))
    poses = _grid(world, lens, rng) if options.flight == "grid" else _flight(world, rng)
    # Exposure and colour follow the clouds: slow waves along the flight.
    t = np.linspace(0, 1, len(poses))
    waves = [np.sin(2 * np.pi * (rng.uniform(0.7, 1.8) * t + rng.uniform())) for _ in range(3)]
    shots = []
    for number, k in enumerate(rng.permutation(len(poses))):
        balance = (float(1 + 0.03 * waves[1][k]), 1.0, float(1 - 0.03 * waves[2][k]))
        sensor = Sensor(exposure=float(1 + 0.08 * waves[0][k]), white_balance=balance, blur_px=0.5)
        shots.append(Shot(Camera(f"airborne/air_{number:03d}.jpg", lens, poses[k]), sensor, "airborne"))
    return shots


def ground_shots(world: World) -> list[Shot]:
    """Each group walks along another building with another phone.

    Raises `InputError` when there are not enough buildings to walk round, or not enough room round one.
    """
    shots = []
    for group in range(world.options.groups):
        if world.options.real:
            shots += _real_group(world, group)
            continue
        walk = walk_of(world, group)
        rng = stream(world.options.key, "phone", group)
        letter = chr(ord("a") + group)
        exposure, red, blue = (float(x) for x in (rng.uniform(0.9, 1.2), *rng.uniform(0.95, 1.05, 2)))
        for number, k in enumerate(rng.permutation(len(walk.poses))):
            gain = float(rng.uniform(0.95, 1.05))
            sensor = Sensor(exposure * gain, (red, 1.0, blue), noise=0.01)
            camera = Camera(f"ground/{letter}_{number:03d}.jpg", walk.lens, walk.poses[k])
            shots.append(Shot(camera, sensor, "ground", letter))
    return shots


def _real_group(world: World, group: int) -> list[Shot]:
    """The photos of one group under real conditions, numbered as they are taken, in a folder of their own."""
    walk = real_walk_of(world, group)
    rng = stream(world.options.key, "real photos", group)
    letter = chr(ord("a") + group)
    sensors = sensors_of(carrier_of(world.options, group), len(walk.poses), rng)
    shots = []
    for k, pose in enumerate(walk.poses):
        camera = Camera(f"ground_{letter}/{letter}_{k:03d}.jpg", walk.lens, pose)
        shots.append(Shot(camera, sensors[k], "ground", letter, walk.motions[k], walk.pieces[k]))
    return shots


def security_shots(world: World) -> list[Shot]:
    """Cameras with strong distortion on poles and on neighbouring walls, looking down at what the walks also see.

    Raises `InputError` when there is no room for them.
    """
    options = world.options
    numbers = stream(options.key, "security").permutation(options.security)
    shots: list[Shot] = []
    for k in range(options.security):
        rng = stream(options.key, "security", k)
        k1 = float(rng.uniform(-0.28, -0.10))
        # The second term keeps the polynomial growing out to any radius: 9 k1^2 < 20 k2.
        k2, p1, p2 = float(rng.uniform(0.65, 0.8)) * k1**2, *(float(p) for p in rng.normal(0, 4e-4, 2))
        lens = make_lens(options, rng, float(rng.uniform(0.55, 0.67)), (k1, k2, p1, p2))
        taken = [shot.camera.centre for shot in shots]
        group = k % max(options.groups, 1)
        walk = real_walk_of(world, group) if options.real else walk_of(world, group)
        pose = watching(world, walk, lens, rng, taken)
        tint = (float(rng.uniform(0.9, 1.1)), 1.0, float(rng.uniform(0.9, 1.1)))
        sensor = Sensor(float(rng.uniform(0.8, 1.25)), tint, blur_px=0.9, noise=0.025, vignetting=0.3)
        shots.append(Shot(Camera(f"ground/security_{numbers[k]:03d}.jpg", lens, pose), sensor, "ground", "security"))
    return shots


def true_view(world: World, name: str) -> tuple[Camera, Scene]:
    """The true camera of a photo, and the scene of its day. Raises `InputError` when the site has no such photo."""
    folder = name.partition("/")[0]
    camera = _cameras(world, folder).get(name)
    if camera is None:
        raise InputError(f"{name}: the simulated site has no such photo; give names relative to its folder")
    dates = dates_of(world.options)
    return camera, world.scene(dates.airborne if folder == "airborne" else dates.ground)


@lru_cache(maxsize=4)
def _cameras(world: World, folder: str) -> dict[str, Camera]:
    shots = airborne_shots(world) if folder == "airborne" else [*ground_shots(world), *security_shots(world)]
    return {shot.camera.image: shot.camera for shot in shots}


def _grid(world: World, lens: Intrinsics, rng: np.random.Generator) -> list[Similarity]:
    options = world.options
    middle = np.array([0.0, 0.0, float(ground_up(world, np.zeros((1, 2)))[0])])
    return grid_poses(rng, lens, options.airborne, middle, options.radius_m, options.tilt_deg)


def _flight(world: World, rng: np.random.Generator) -> list[Similarity]:
    """Poses in the order of flight, whose mean distance to the middle is the preset's."""
    options = world.options
    middle = np.array([0.0, 0.0, float(ground_up(world, np.zeros((1, 2)))[0])])
    scale = float(np.clip(options.radius_m / FULL_RADIUS_M, 0.5, 1.0))
    standoff = STANDOFF_M[options.preset] * scale
    n_nadir = min(max(round(NADIR_SHARE * options.airborne), 4), options.airborne)
    up_m = float(np.clip(0.7 * standoff, 60 * scale, 95 * scale))
    poses = list(_strips(rng, n_nadir, middle, up_m, options.radius_m))
    below_m = sum(float(np.linalg.norm(pose.inverse().translation - middle)) for pose in poses)
    left = options.airborne - n_nadir
    if left:
        poses += _rings(rng, left, middle, (options.airborne * standoff - below_m) / left, options.radius_m)
    return poses


def _strips(rng: np.random.Generator, count: int, middle: Array, up_m: float, radius_m: float) -> Iterator[Similarity]:
    """A serpentine of strips; 65 % overlap along and across, more where the site is small."""
    rows = max(round(np.sqrt(count / 1.35)), 1)
    columns = -(-count // rows)
    along = min(0.30 * up_m, 2 * radius_m / max(columns - 1, 1))
    across = min(0.405 * up_m, 2 * radius_m / max(rows - 1, 1))
    heading = rng.uniform(0, 360)
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    for k in range(count):
        row, column = divmod(k, columns)
        back = row % 2 == 1
        x = (row - (rows - 1) / 2) * across
        y = ((columns - 1 - column if back else column) - (columns - 1) / 2) * along
        plan = np.array([c * x + s * y, c * y - s * x]) + rng.normal(scale=1.5, size=2)
        centre = middle + [*plan, up_m + rng.normal(scale=1.0)]
        yaw, pitch, lean = rng.normal(scale=(2.0, 2.5, 2.5))
        rotation = looking(heading + (180 if back else 0) + yaw, -90 + pitch)
        # A lean to the side of a camera that looks down is a turn about its own y axis.
        c_lean, s_lean = np.cos(np.radians(lean)), np.sin(np.radians(lean))
        yield standing_at(centre, np.array([[c_lean, 0, s_lean], [0, 1, 0], [-s_lean, 0, c_lean]]) @ rotation)


def _rings(
    rng: np.random.Generator, count: int, middle: Array, distance_m: float, radius_m: float
) -> Iterator[Similarity]:
    """One ring, or two when there are enough photos for 24 azimuths on the first one."""
    outer = count if count < 32 else max(24, round(0.7 * count))
    # The fewer photos, the steeper: neighbours on a steep ring differ less.
    low = float(np.interp(outer, (8, 24), (56.0, 46.5)))
    for n, depressions in ((outer, (low, low + 3.0)), (count - outer, (56.0, 60.0))):
        start = rng.uniform(0, 360)
        for k in range(n):
            azimuth = start + 360 / n * (k + rng.uniform(-0.2, 0.2))
            down = float(rng.uniform(*depressions))
            a, d = np.radians([azimuth, down])
            away = np.array([np.sin(a) * np.cos(d), np.cos(a) * np.cos(d), np.sin(d)])
            target = middle + [*rng.normal(scale=0.08 * radius_m, size=2), 0.0]
            centre = target + away * distance_m * rng.uniform(0.97, 1.03)
            yaw, pitch, roll = rng.normal(scale=(0.8, 0.4, 1.0))
            yield standing_at(centre, looking(azimuth + 180 + yaw, -down + pitch, roll))
