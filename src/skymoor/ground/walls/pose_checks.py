# SPDX-License-Identifier: Apache-2.0
"""Pose check of each camera of a registered ground component (the paper's failure A08).

One similarity transforms all cameras; a camera with a wrong pose from structure from motion is then wrong on Earth as
well. Each photo alone is compared with the airborne walls that it should show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skymoor.densify import empty_depth_map
from skymoor.geometry import Similarity
from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions
from skymoor.ground.walls.dense import photo_matches
from skymoor.ground.walls.facade_pairs import pair_facades
from skymoor.ground.walls.facade_search import drift
from skymoor.ground.walls.figure import walls_figure
from skymoor.types import Camera, DepthMap, Image, Photos


@dataclass(frozen=True)
class GroundPoseOptions:
    """When a camera contradicts its component.

    Attributes:
        min_matches: with fewer, matches neither confirm nor contradict.
        max_offset_m: largest median distance between a wall and its position in the photo.
        max_offset_ratio: the same in units of the median over the cameras: where walls repeat themselves, all offsets
            are larger.
        min_lead: a larger offset contradicts only if the photo also agrees so many times better with the walls when it
            is shifted.
        reach_m: shifts up to this are tried.
        min_score, min_gain: a photo contradicts if its score at the best shift is at least so high, and so many times
            that without shift.
    """

    min_matches: int = 150
    max_offset_m: float = 0.75
    max_offset_ratio: float = 6.0
    min_lead: float = 1.05
    reach_m: float = 5.0
    min_score: float = 20.0
    min_gain: float = 1.25


@dataclass(frozen=True)
class GroundPoseCheck:
    """Consistency of one photo with the airborne walls: scores and the offset of the walls in it (median, m).

    `score` is without shift, `best_score` at the best shift within reach; `tested` is false with too few matches.
    """

    image: str
    score: float
    best_score: float
    n_matches: int
    offset_m: float
    tested: bool
    contradicts: bool


def check_poses_on_walls(
    maps_level: Sequence[DepthMap],
    airborne: AirborneWalls,
    enu_from_level: Similarity,
    options: GroundOptions | None = None,
    limits: GroundPoseOptions | None = None,
    *,
    rng: np.random.Generator,
) -> list[GroundPoseCheck]:
    """One consistency record per photo, in input order. Its own depth map is ignored, since a wrong pose corrupts it.

    Errors along the viewing direction (wrong focal length) are not detectable.
    """
    options, limits = options or GroundOptions(), limits or GroundPoseOptions()
    checks = [_check(depth_map, airborne, enu_from_level, options, limits, rng) for depth_map in maps_level]
    usual = float(np.median([w.offset_m for w in checks if w.n_matches >= limits.min_matches] or [0.0]))
    limit = max(limits.max_offset_m, limits.max_offset_ratio * usual)
    return [replace(w, contradicts=w.contradicts or _off(w, limit, limits)) for w in checks]


def _off(check: GroundPoseCheck, limit_m: float, limits: GroundPoseOptions) -> bool:
    """Whether matches show an offset, and correlation of the whole image supports it."""
    leads = check.best_score > limits.min_lead * check.score
    return check.tested and check.offset_m > limit_m and leads


def _check(
    depth_map: DepthMap,
    airborne: AirborneWalls,
    enu_from_level: Similarity,
    options: GroundOptions,
    limits: GroundPoseOptions,
    rng: np.random.Generator,
) -> GroundPoseCheck:
    """The record of one photo; `contradicts` where it agrees much better with a shift."""
    alone = [replace(depth_map, depth=np.full_like(depth_map.depth, np.nan))]
    pairs = pair_facades(airborne.facades, airborne.heights, alone, enu_from_level, options.facade_pairs)
    reach, still = (round(metres / options.pixel_m) for metres in (limits.reach_m, limits.max_offset_m))
    found = [drift(p.ground, p.airborne, reach_px=reach, still_px=still, options=options.search) for p in pairs]
    drifts = [d for d in found if d is not None]
    score, best = (float(np.linalg.norm(values)) for values in ([d.here for d in drifts], [d.there for d in drifts]))
    elsewhere = best >= limits.min_score and best > limits.min_gain * score
    matches = photo_matches(pairs, enu_from_level, options.dense, options.cyclic, rng=rng)
    gaps = enu_from_level.apply(matches.xyz_level) - matches.xyz_enu
    offset = float(np.linalg.norm(np.median(gaps, axis=0))) if len(gaps) else float("nan")
    if elsewhere:
        clearest = max(drifts, key=lambda d: d.there)
        offset = float(np.hypot(*clearest.px)) * options.pixel_m
    tested = len(matches) >= limits.min_matches or elsewhere
    return GroundPoseCheck(depth_map.camera.image, score, best, len(matches), offset, tested, contradicts=elsewhere)


def check_ground_poses(
    cameras: Sequence[Camera],
    maps_level: Sequence[DepthMap],
    photos: Photos,
    airborne: AirborneWalls,
    enu_from_level: Similarity,
    options: GroundOptions | None = None,
    *,
    max_px: int,
    seed: int = 0,
) -> tuple[list[GroundPoseCheck], Image | None]:
    """`check_poses_on_walls` for all cameras of a component, and a figure of its walls.

    Args:
        cameras: of the component; those without a depth map are checked by their photos, of `max_px` along the side.
        maps_level, photos, airborne, enu_from_level, options: see `check_poses_on_walls`.
        seed: of random choices.
    """
    measured = {depth_map.camera.image for depth_map in maps_level}
    others = [camera for camera in cameras if camera.image not in measured]
    maps = [*maps_level, *(empty_depth_map(camera, photos, max_px) for camera in others)]
    checks = check_poses_on_walls(maps, airborne, enu_from_level, options, rng=np.random.default_rng(seed))
    return checks, walls_figure(maps_level, airborne, enu_from_level, options)
