# SPDX-License-Identifier: Apache-2.0
"""Whether each camera of a registered ground component bears the component's place out (the paper's failure A08).

One similarity moves all cameras; a camera that structure from motion put wrongly is then wrong on Earth as well. Each
photo alone is laid on the airborne walls that it should show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skymoor.facade import counterparts
from skymoor.geometry.similarity import Similarity
from skymoor.ground.matches import photo_matches
from skymoor.ground.walls import AirborneWalls, GroundOptions
from skymoor.match import agreement
from skymoor.types import DepthMap


@dataclass(frozen=True)
class CameraOptions:
    """When a camera contradicts its component.

    Attributes:
        min_matches: with fewer a camera has no say, for or against.
        max_offset_m: largest median distance between where a wall is and where the photo shows it.
        max_offset_ratio: the same in units of what the component's cameras have in the middle: where walls repeat
            themselves, all of them are seen less well.
    """

    min_matches: int = 150
    max_offset_m: float = 0.75
    max_offset_ratio: float = 6.0


@dataclass(frozen=True)
class CameraWitness:
    """What one photo says: how well it agrees with the airborne walls, and how far off it shows them (median, m)."""

    image: str
    ncc: float
    n_matches: int
    offset_m: float
    heard: bool
    contradicts: bool


def hear_cameras(
    maps_level: Sequence[DepthMap],
    airborne: AirborneWalls,
    enu_from_level: Similarity,
    options: GroundOptions | None = None,
    limits: CameraOptions | None = None,
    *,
    rng: np.random.Generator,
) -> list[CameraWitness]:
    """The witness of each photo, in their order; their depths are not used, for a wrong pose makes them wrong too.

    Offsets beyond the dense matcher's reach, 1.6 m by default, leave a camera without matches, and so unheard.
    """
    options, limits = options or GroundOptions(), limits or CameraOptions()
    heard = []
    for depth_map in maps_level:
        alone = [replace(depth_map, depth=np.full_like(depth_map.depth, np.nan))]
        pairs = counterparts(airborne.facades, airborne.relief, alone, enu_from_level, options.counterparts)
        ncc, _ = agreement([(pair.near, pair.far) for pair in pairs], options.search)
        matches = photo_matches(pairs, enu_from_level, options.dense, options.cyclic, rng=rng)
        gaps = enu_from_level.apply(matches.xyz_level) - matches.xyz_enu
        offset = float(np.linalg.norm(np.median(gaps, axis=0))) if len(gaps) else float("nan")
        enough = len(matches) >= limits.min_matches
        heard.append(CameraWitness(depth_map.camera.image, ncc, len(matches), offset, enough, contradicts=False))
    usual = float(np.median([witness.offset_m for witness in heard if witness.heard] or [0.0]))
    limit = max(limits.max_offset_m, limits.max_offset_ratio * usual)
    return [replace(witness, contradicts=witness.heard and witness.offset_m > limit) for witness in heard]
