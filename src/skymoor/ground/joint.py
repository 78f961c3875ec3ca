# SPDX-License-Identifier: Apache-2.0
"""Joint decision on components: the surface of one must not lie in the observed free space of another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.hypotheses import Hypotheses
from skymoor.registration.criteria import criterion, refusal_of
from skymoor.types import Array, Criterion, DepthMap, Registration


@dataclass(frozen=True)
class JointOptions:
    """When two components contradict each other.

    Attributes:
        max_conflict: largest share of the points of both, of those that the other should see, in its free space.
        min_shared: such points; with fewer there is no conflict.
        tolerance_m, tolerance_ratio: depths that differ by no more than either are the same.
        points: of each component, drawn evenly, that are compared.
    """

    max_conflict: float = 0.5
    min_shared: int = 150
    tolerance_m: float = 1.0
    tolerance_ratio: float = 0.1
    points: int = 3000


def decide_jointly(
    names: Sequence[str],
    searches: Sequence[Hypotheses],
    maps_level: Sequence[Sequence[DepthMap]],
    options: JointOptions | None = None,
) -> list[Registration]:
    """The registration of each component, in the order of confidence, so that none contradicts a more confident one.

    A hypothesis that does is excluded, and no longer competes with the others: what is known of one component may
    decide about another.

    Args:
        names: for the reasons of refusals.
        searches: hypotheses of each component.
        maps_level: depth maps of each component, in its level frame.
        options: see there.
    """
    options = options or JointOptions()
    points = [_sampled(maps, options.points) for maps in maps_level]
    excluded: list[dict[int, tuple[Criterion, str]]] = [{} for _ in searches]
    decided: dict[int, Registration] = {}
    while True:
        open_ = {k: search.decide(excluded[k]) for k, search in enumerate(searches) if k not in decided}
        passing = [k for k, found in open_.items() if found.registered]
        if not passing:
            return [decided.get(k) or _explained(open_[k], excluded[k]) for k in range(len(searches))]
        best = max(passing, key=lambda k: open_[k].diagnostics["score"])
        decided[best] = open_[best]
        enu_from_best = open_[best].enu_from_level
        assert enu_from_best is not None
        for k in open_.keys() - {best}:
            for number, enu_from_k in enumerate(searches[k].similarities):
                anchor = (points[best], maps_level[best], enu_from_best)
                share = conflict(points[k], maps_level[k], enu_from_k, *anchor, options)
                conflicts = criterion("conflict", share, options.max_conflict)
                if not conflicts.passed:
                    excluded[k].setdefault(number, (conflicts, names[best]))


def conflict(
    points_a: Array,
    maps_a: Sequence[DepthMap],
    enu_from_a: Similarity,
    points_b: Array,
    maps_b: Sequence[DepthMap],
    enu_from_b: Similarity,
    options: JointOptions | None = None,
) -> float:
    """Share of the surfaces that both show, in the observed free space of the other; 0 where they overlap little.

    Both directions are counted together: the points of one component that lie far from its cameras, and so metres in
    front of a wall, may be few and nearly all in free space, while the other confirms hundreds on that wall.

    Args:
        points_a, points_b: (n, 3) in each one's level frame.
        maps_a, maps_b: depth maps in the same frames.
        enu_from_a, enu_from_b: their registrations.
        options: see there.
    """
    options = options or JointOptions()
    b_from_a = enu_from_b.inverse() @ enu_from_a
    ways = [
        (b_from_a.apply(points_a), maps_b, enu_from_b.scale),
        (b_from_a.inverse().apply(points_b), maps_a, enu_from_a.scale),
    ]
    counts = [
        _seen_through(points, maps, options.tolerance_m / scale, options.tolerance_ratio)
        for points, maps, scale in ways
    ]
    through, confirmed = np.sum(counts, axis=0)
    return float(through / (through + confirmed)) if through + confirmed >= options.min_shared else 0.0


def _seen_through(points: Array, maps: Sequence[DepthMap], tolerance: float, ratio: float) -> tuple[int, int]:
    """How many points lie in the free space of most photos, and how many on their surfaces.

    Points that are hidden, outside, or without a known depth count for neither.
    """
    through, on_surface = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for depth_map in maps:
        i = depth_map.camera.intrinsics
        xyz = depth_map.camera.cam_from_world.apply(points)
        front = np.flatnonzero(xyz[:, 2] > tolerance)
        u, v = i.px_from_cam(xyz[front]).T
        inside = (u >= 0) & (v >= 0) & (u < i.width) & (v < i.height)
        index, z = front[inside], xyz[front[inside], 2]
        depth = depth_map.depth[v[inside].astype(np.intp), u[inside].astype(np.intp)]
        allowed = np.maximum(tolerance, ratio * z)
        with np.errstate(invalid="ignore"):
            through[index[depth > z + allowed]] += 1
            on_surface[index[np.abs(depth - z) <= allowed]] += 1
    return int(np.count_nonzero(through > on_surface)), int(
        np.count_nonzero((on_surface >= through) & (on_surface > 0))
    )


def _sampled(maps: Sequence[DepthMap], count: int) -> Array:
    """Up to about `count` points (n, 3) of all photos, evenly."""
    if not maps:
        return np.zeros((0, 3))
    points = np.concatenate([depth_map.points(step=4)[0] for depth_map in maps])
    return points[:: max(1, len(points) // count)].astype(np.float64)


def _explained(refused: Registration, excluded: dict[int, tuple[Criterion, str]]) -> Registration:
    """A refusal that says if the best hypothesis was excluded because it contradicts another component."""
    if 0 not in excluded:
        return refused
    conflicts, other = excluded[0]
    reason = f"at the best hypothesis {refusal_of(conflicts, {'other': other})}; elsewhere {refused.reason}"
    return replace(refused, reason=reason, criteria=(conflicts, *refused.criteria))
