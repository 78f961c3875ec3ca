# SPDX-License-Identifier: Apache-2.0
"""Components decided together: what one shows must not stand in what another looks through."""

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
        max_conflict: share of what one shows, of that which the other should see, that may stand in its free space.
        min_shared: points of which that can be said; with fewer there is no telling.
        tolerance_m, tolerance_ratio: depths that differ by no more than either are the same.
        points: of each component, drawn evenly, that are looked at.
    """

    max_conflict: float = 0.5
    min_shared: int = 150
    tolerance_m: float = 1.0
    tolerance_ratio: float = 0.1
    points: int = 3000


def decide_jointly(
    names: Sequence[str],
    answers: Sequence[Hypotheses],
    maps_level: Sequence[Sequence[DepthMap]],
    options: JointOptions | None = None,
) -> list[Registration]:
    """The registration of each component, the surest first, so that none contradicts a surer one.

    A place that does is out, and no longer counts as another place that is nearly as good: what is known of one
    component may decide where another stands.

    Args:
        names: for the reasons of refusals.
        answers: of each component's search.
        maps_level: depth maps of each component, in its level frame.
        options: see there.
    """
    options = options or JointOptions()
    shown = [_sampled(maps, options.points) for maps in maps_level]
    excluded: list[dict[int, tuple[Criterion, str]]] = [{} for _ in answers]
    decided: dict[int, Registration] = {}
    while True:
        judged = {k: answers[k].decide(excluded[k]) for k in range(len(answers)) if k not in decided}
        passing = [k for k, found in judged.items() if found.registered]
        if not passing:
            return [decided.get(k) or _explained(judged[k], excluded[k]) for k in range(len(answers))]
        surest = max(passing, key=lambda k: judged[k].diagnostics["score"])
        decided[surest] = judged[surest]
        surely = judged[surest].enu_from_level
        assert surely is not None
        for k in judged.keys() - {surest}:
            for number, place in enumerate(answers[k].places):
                share = conflict(shown[k], maps_level[k], place, shown[surest], maps_level[surest], surely, options)
                conflicts = criterion("conflict", share, options.max_conflict)
                if not conflicts.passed:
                    excluded[k].setdefault(number, (conflicts, names[surest]))


def conflict(
    points_a: Array,
    maps_a: Sequence[DepthMap],
    enu_from_a: Similarity,
    points_b: Array,
    maps_b: Sequence[DepthMap],
    enu_from_b: Similarity,
    options: JointOptions | None = None,
) -> float:
    """How much of what each of two components shows stands where the other looks through; 0 where they share little.

    The larger share of both ways round: either's photos may be those that look.

    Args:
        points_a, points_b: (n, 3) in each one's level frame.
        maps_a, maps_b: depth maps in the same frames.
        enu_from_a, enu_from_b: where they stand.
        options: see there.
    """
    options = options or JointOptions()
    b_from_a = enu_from_b.inverse() @ enu_from_a
    ways = [
        (b_from_a.apply(points_a), maps_b, enu_from_b.scale),
        (b_from_a.inverse().apply(points_b), maps_a, enu_from_a.scale),
    ]
    shares = [0.0]
    for points, maps, scale in ways:
        through, borne_out = _seen_through(points, maps, options.tolerance_m / scale, options.tolerance_ratio)
        if through + borne_out >= options.min_shared:
            shares.append(through / (through + borne_out))
    return max(shares)


def _seen_through(points: Array, maps: Sequence[DepthMap], tolerance: float, ratio: float) -> tuple[int, int]:
    """How many points stand where most photos look through, and how many where they show something.

    Points that are hidden, outside, or where depth is not known count for neither.
    """
    through, there = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
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
            there[index[np.abs(depth - z) <= allowed]] += 1
    return int(np.count_nonzero(through > there)), int(np.count_nonzero((there >= through) & (there > 0)))


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
