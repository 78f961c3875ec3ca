# SPDX-License-Identifier: Apache-2.0
"""Two walks that were laid on one another must be taken apart, and one walk must be left whole."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.reconstruct import ConflictFilter, ViewGraph
from skymoor.types import Camera, Component, Photos
from support.blocks import observed
from support.walks import walk, wall_points

Array = NDArray[np.float64]
REPEATABILITY = 0.7  # share of the photos that ought to observe a point and do


def photos_of(names: list[str]) -> Photos:
    def read(name: str) -> NDArray[np.uint8]:
        raise AssertionError(f"{name}: there is no need to look")

    return Photos(tuple(names), ((640, 480),) * len(names), read)


def graph_of(*components: Component, more: tuple[str, ...] = ()) -> ViewGraph:
    """All pairs of the components' photos, and of `more` that are in none."""
    names = [camera.image for component in components for camera in component.cameras] + list(more)
    pairs = tuple(combinations(range(len(names)), 2))
    return ViewGraph(photos_of(names), pairs, tuple(np.zeros((20, 4)) for _ in pairs), components)


def kept(graph: ViewGraph, options: ConflictFilter | None = None) -> set[frozenset[str]]:
    names, rows = graph.photos.names, (options or ConflictFilter())(graph)
    assert rows == sorted(set(rows))
    return {frozenset((names[graph.pairs[k][0]], names[graph.pairs[k][1]])) for k in rows}


def pairs_within(*groups: list[Camera]) -> set[frozenset[str]]:
    return {frozenset(pair) for group in groups for pair in combinations([c.image for c in group], 2)}


def named(cameras: list[Camera], letter: str) -> list[Camera]:
    return [replace(camera, image=f"{letter}_{camera.image}") for camera in cameras]


def seen_by(component: Component, rng: np.random.Generator, whose: list[frozenset[int]]) -> Component:
    """Only observations by the cameras that know a point, and of those not all."""
    known = np.array([camera in whose[point] for camera, point in zip(*ties(component), strict=True)])
    stays = known & (rng.uniform(size=len(known)) < REPEATABILITY)
    return replace(
        component,
        obs_camera=component.obs_camera[stays],
        obs_point=component.obs_point[stays],
        obs_px=component.obs_px[stays],
    )


def ties(component: Component) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    return component.obs_camera, component.obs_point


def folded(share: float, *, n: int = 1500) -> tuple[Component, list[Camera], list[Camera]]:
    """Walks round two buildings, laid on one: a share of the points belongs to both, of the others half to each."""
    a, b = named(walk(), "a"), named(walk(seed=8), "b")
    rng = np.random.default_rng(0)
    everyone = frozenset(range(len(a) + len(b)))
    mine, other = frozenset(range(len(a))), frozenset(range(len(a), len(a) + len(b)))
    whose = [everyone if u < share else mine if u < (1 + share) / 2 else other for u in rng.uniform(size=n)]
    return seen_by(observed([*a, *b], wall_points(n)), rng, whose), a, b


@pytest.mark.parametrize("share", [0.02, 0.08])
def test_walks_round_twins_are_taken_apart(share: float) -> None:
    component, a, b = folded(share)
    assert kept(graph_of(component)) == pairs_within(a, b)


def test_two_walks_along_one_wall_stay_together() -> None:
    # On another day half of the features are others.
    component, a, b = folded(0.5)
    assert kept(graph_of(component)) == pairs_within([*a, *b])


def test_one_walk_stays_whole() -> None:
    rng = np.random.default_rng(1)
    cameras = walk(12)
    component = seen_by(observed(cameras, wall_points(1500)), rng, [frozenset(range(12))] * 1500)
    assert kept(graph_of(component)) == pairs_within(cameras)


def test_how_little_is_a_contradiction_is_an_option() -> None:
    component, a, b = folded(0.08)
    assert kept(graph_of(component), ConflictFilter(conflict_ratio=0.02)) == pairs_within([*a, *b])
    component, a, b = folded(0.5)
    assert kept(graph_of(component), ConflictFilter(conflict_ratio=0.9)) == pairs_within(a, b)


def test_a_corner_that_hides_is_no_contradiction() -> None:
    """Round a corner, cameras are expected to share the little that looks along both walls, and do not."""
    a = named(walk(along_m=(0.0, 14.0)), "a")
    b = named(walk(along_m=(21.0, 24.0), seed=8), "b")
    points = np.concatenate([wall_points(1500), wall_points(1500, seed=2) + [12.0, 0.0, 0.0]])
    mine, other = frozenset(range(len(a))), frozenset(range(len(a), len(a) + len(b)))
    whose = [mine if x < 17.0 else other for x in points[:, 0]]
    rng = np.random.default_rng(3)
    component = seen_by(observed([*a, *b], points), rng, whose)
    expected, shared = ConflictFilter().shared_points(component)
    across = np.ix_(sorted(mine), sorted(other))
    assert expected[across].max() >= ConflictFilter().min_expected and not shared[across].any()
    assert kept(graph_of(component)) == pairs_within([*a, *b])
    assert kept(graph_of(component), ConflictFilter(min_overlap=0.0)) != pairs_within([*a, *b])


def test_pairs_across_components_and_of_lost_photos_are_kept() -> None:
    component, a, b = folded(0.05)
    other = replace(component, cameras=tuple(named(list(component.cameras), "other")))
    found = kept(graph_of(component, other, more=("lost",)))
    assert frozenset(("lost", "a_walk_0")) in found
    assert frozenset(("a_walk_0", "other_b_walk_3")) in found
    assert frozenset(("other_a_walk_0", "other_b_walk_3")) not in found
    assert len(found) == 37 * 36 // 2 - 2 * len(a) * len(b)


def test_expected_points_are_those_that_are_seen_from_nearly_the_same_place() -> None:
    cameras = walk(9, roll_deg=0.0)
    component = observed(cameras, wall_points(600))
    expected, shared = ConflictFilter().shared_points(component)
    np.testing.assert_array_equal(expected, expected.T)
    # Nothing is missing: whatever is expected is there, and neighbours expect more than those far apart.
    np.testing.assert_array_equal(expected, shared)
    assert expected[0, 1] > 100 and not np.diag(expected).any()
    assert expected[0, 8] == 0  # twenty metres apart, ten metres before a wall
    wider, narrower = (ConflictFilter(max_angle_deg=deg).shared_points(component)[0] for deg in (45.0, 8.0))
    assert wider.sum() > 1.2 * expected.sum() and narrower.sum() < 0.8 * expected.sum()


def test_nothing_reconstructed_says_nothing() -> None:
    assert ConflictFilter()(graph_of(more=("x", "y", "z"))) == [0, 1, 2]
    lonely = observed(walk(3), wall_points(20))
    assert kept(graph_of(lonely)) == pairs_within(walk(3))
