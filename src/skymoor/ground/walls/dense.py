# SPDX-License-Identifier: Apache-2.0
"""Dense matches between a ground model and airborne walls, given an approximate registration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.walls.facade_pairs import FacadePair
from skymoor.ground.walls.facades import Facade, affine_between
from skymoor.match import CyclicOptions, DenseMatcher, cyclic_matches, match_hypothesis
from skymoor.types import Array, Matches3D

FEWEST_PX = 300
OVERLAP_PX = 10


def wall_matches(
    facades: Sequence[Facade],
    others: Sequence[Facade],
    enu_from_level: Similarity,
    matcher: DenseMatcher,
    cyclic: CyclicOptions,
    *,
    max_angle_deg: float,
    max_gap_m: float,
    rng: np.random.Generator,
) -> Matches3D:
    """Matches of every ground wall with every airborne wall that it coincides with; points on the walls' planes.

    A wall's plane is known better than any single depth on it, and windows have no depth at all.
    """
    found = []
    for facade, other, b_from_a in _couples(facades, others, enu_from_level, max_angle_deg, max_gap_m):
        matches, _ = match_hypothesis(facade.raster, other.raster, b_from_a, matcher, cyclic, rng=rng)
        found.append(Matches3D(facade.xyz(matches.px_a), other.xyz(matches.px_b), matches))
    return Matches3D.joined(found)


def photo_matches(
    pairs: Sequence[FacadePair],
    enu_from_level: Similarity,
    matcher: DenseMatcher,
    cyclic: CyclicOptions,
    *,
    rng: np.random.Generator,
) -> Matches3D:
    """Matches of photos with airborne walls, also of walls for which the ground model has no depth.

    The ground point is taken on the airborne wall and mapped back by `enu_from_level`: such a match determines the
    shift within the plane of the wall. The distance of the plane follows from the other walls and `wall_matches`.
    """
    level_from_enu = enu_from_level.inverse()
    found = []
    for pair in pairs:
        matches = cyclic_matches(matcher(pair.ground, pair.airborne), cyclic, rng=rng)
        xyz_level = level_from_enu.apply(pair.facade.xyz(matches.px_a + pair.offset_px))
        found.append(Matches3D(xyz_level, pair.facade.xyz(matches.px_b + pair.offset_px), matches))
    return Matches3D.joined(found)


def _couples(
    facades: Sequence[Facade],
    others: Sequence[Facade],
    enu_from_level: Similarity,
    max_angle_deg: float,
    max_gap_m: float,
) -> Iterator[tuple[Facade, Facade, Array]]:
    """Walls that coincide, with the affine (2, 3) between their pixels."""
    for facade in facades:
        if facade.raster.mask.sum() < FEWEST_PX:
            continue
        normal = enu_from_level.rotation[:2, :2] @ facade.wall.normal
        centre = enu_from_level.apply(facade.wall.centre)
        for other in others:
            parallel = normal @ other.wall.normal >= np.cos(np.radians(max_angle_deg))
            if parallel and abs(centre[:2] @ other.wall.normal - other.wall.offset) <= max_gap_m:
                b_from_a = affine_between(facade, other, enu_from_level)
                if _overlap(facade, other, b_from_a):
                    yield facade, other, b_from_a


def _overlap(facade: Facade, other: Facade, b_from_a: Array) -> bool:
    """Whether the orthophotos share more than an edge."""
    h, w = facade.raster.mask.shape
    first, last = np.array([[0.0, 0.0], [w, h]]) @ b_from_a[:, :2].T + b_from_a[:, 2]
    shared = np.minimum(last, other.raster.mask.shape[::-1]) - np.maximum(first, 0)
    return bool((shared >= OVERLAP_PX).all())
