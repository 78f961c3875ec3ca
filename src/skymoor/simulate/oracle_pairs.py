# SPDX-License-Identifier: Apache-2.0
"""The oracle among feature engines: places on the surface, seen in several photos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from skymoor.simulate.capture.shots import true_view
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import stream
from skymoor.simulate.world import World
from skymoor.types import Camera, Photos, Progress

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NEAR_SHARE = 0.998  # of the way to a point must be free for it to be seen


@dataclass(frozen=True)
class OraclePairMatcher:
    """Matches of places on the surface, by what each photo sees of them; geometrically verified like any others.

    Attributes:
        world: the site that the photos are of.
        name_in_database: of photo k of a size (width, height), as the reconstruction names it.
        landmarks: drawn in each photo, and looked for in all others.
        noise_px: standard deviation of a key point's coordinates.
        outlier_share: share of a pair's matches that lead elsewhere.
        shared_camera: photos of one size are taken by one camera.
        min_matches: pairs with less in common are left out.
    """

    world: World
    name_in_database: Callable[[int, tuple[int, int]], str]
    landmarks: int = 300
    noise_px: float = 0.3
    outlier_share: float = 0.0
    shared_camera: bool = True
    min_matches: int = 20

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; the pixels of the photos are not looked at."""
        rng = stream(seed, "landmarks")
        truths = [true_view(self.world, name) for name in photos.names]
        points = np.concatenate([_landmarks(camera, scene, self.landmarks, rng) for camera, scene in truths])
        names = [self.name_in_database(k, size) for k, size in enumerate(photos.sizes)]
        seen = []
        with pycolmap.Database.open(database) as db:
            ids = _enter(db, names, photos.sizes, shared_camera=self.shared_camera)
            for done, (camera, scene) in enumerate(truths):
                px, visible = _visible(camera, scene, points)
                seen.append(np.flatnonzero(visible))
                noisy = px[visible] + rng.normal(scale=self.noise_px, size=(len(seen[-1]), 2))
                db.write_keypoints(ids[done], noisy.astype(np.float32))
                progress(done + 1, len(truths) + 1)
            pairs = []
            for i, j in combinations(range(len(names)), 2):
                _, in_i, in_j = np.intersect1d(seen[i], seen[j], assume_unique=True, return_indices=True)
                if len(in_i) >= self.min_matches:
                    wrong = np.flatnonzero(rng.uniform(size=len(in_i)) < self.outlier_share)
                    in_j[wrong] = in_j[rng.permutation(wrong)]
                    db.write_matches(ids[i], ids[j], np.column_stack([in_i, in_j]).astype(np.uint32))
                    pairs.append(f"{names[i]} {names[j]}\n")
        (folder / "pairs.txt").write_text("".join(pairs))
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        pycolmap.verify_matches(database, folder / "pairs.txt", verification)
        progress(len(truths) + 1, len(truths) + 1)


def _landmarks(camera: Camera, scene: Scene, count: int, rng: np.random.Generator) -> Array:
    """Points (n, 3) on what a photo shows; none in the sky."""
    i = camera.intrinsics
    rays = i.rays(rng.uniform([0, 0], [i.width, i.height], (count, 2))) @ camera.cam_from_world.rotation
    distance = scene.cast(camera.centre, rays).distance
    hit = np.isfinite(distance)
    return np.asarray(camera.centre + distance[hit, None] * rays[hit])


def _visible(camera: Camera, scene: Scene, points: Array) -> tuple[Array, Mask]:
    """Pixels (n, 2) of points, and whether they are in the picture with nothing before them."""
    i = camera.intrinsics
    px = i.px_from_cam(camera.cam_from_world.apply(points))
    with np.errstate(invalid="ignore"):
        inside = (px >= 0).all(axis=1) & (px <= [i.width, i.height]).all(axis=1)
    index = np.flatnonzero(np.asarray(inside))
    seen = scene.cast(camera.centre, points[index] - camera.centre).distance > NEAR_SHARE
    visible = np.zeros(len(points), dtype=bool)
    visible[index[seen]] = True
    return px, visible


def _enter(
    db: pycolmap.Database, names: Sequence[str], sizes: Sequence[tuple[int, int]], *, shared_camera: bool
) -> list[int]:
    """Cameras with COLMAP's default initial focal length, and images; returns the images' numbers."""
    rigs: dict[tuple[int, int], tuple[int, int]] = {}
    ids = []
    for name, size in zip(names, sizes, strict=True):
        if size not in rigs or not shared_camera:
            model = "RADIAL" if shared_camera else "SIMPLE_RADIAL"
            camera = pycolmap.Camera.create_from_model_name(0, model, 1.2 * max(size), *size)
            camera.camera_id = db.write_camera(camera)
            rig = pycolmap.Rig()
            rig.add_ref_sensor(camera.sensor_id)
            rigs[size] = camera.camera_id, db.write_rig(rig)
        camera_id, rig_id = rigs[size]
        ids.append(db.write_image(pycolmap.Image(name=name, camera_id=camera_id)))
        frame = pycolmap.Frame(rig_id=rig_id)
        frame.add_data_id(db.read_image(ids[-1]).data_id)
        db.write_frame(frame)
    return ids
