# SPDX-License-Identifier: Apache-2.0
"""Photos of two places that look alike, told apart by what they ought to share and do not.

A reconstruction that has laid one building on its twin fits its own observations, and no error in it is large. But
cameras that now stand side by side and look the same way see few things in common: each sees the cars, trees and
neighbours of its own place. That missing correspondences tell more than those that are there is the idea of Zach,
Irschara and Bischof (CVPR 2008); to look for them in the finished, possibly folded reconstruction, and to split its
cameras where they contradict one another, that of Heinly, Dunn and Frahm (ECCV 2014).

Those compare image segments. Here tracks alone are counted: of the points that one camera observes, another that looks
at them from nearly the same direction and distance ought to observe a share, and how large a share is usual the set
says itself, by each camera's best partner. Cameras are then joined from the strongest pair downwards, but never two
groups whose members ought to share far more than they do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skymoor.reconstruct.protocol import PairFilter, ViewGraph
from skymoor.types import Array, Component, Mask


@dataclass(frozen=True)
class ConflictFilter:
    """Drops the pairs between groups of photos that a first reconstruction has laid on one another wrongly.

    Attributes:
        max_angle_deg: between two cameras' rays to a point that both ought to observe.
        max_scale_ratio: between the sizes at which they see it.
        border_ratio: of the width, along the border of a photo where nothing is expected.
        min_expected: fewer expected points do not contradict anything.
        min_overlap: nor do groups of which less is expected to be shared than this part of what the smaller one
            shares within itself: corners of buildings hide what a camera beyond them is expected to see.
        conflict_ratio: two groups contradict each other if they share less than this part of what is usual.
        rounds: of looking at the reconstruction and having it made again; another one shows other contradictions.
    """

    max_angle_deg: float = 20.0
    max_scale_ratio: float = 1.5
    border_ratio: float = 0.03
    min_expected: int = 40
    min_overlap: float = 0.1
    conflict_ratio: float = 0.3
    rounds: int = 3

    def __call__(self, graph: ViewGraph) -> list[int]:
        """Rows of `graph.pairs` to keep; see `PairFilter`."""
        index = {name: k for k, name in enumerate(graph.photos.names)}
        forbidden = np.zeros((len(index), len(index)), dtype=bool)
        for component in graph.components:
            who = np.array([index[camera.image] for camera in component.cameras])
            for first, second in self.contradictions(component):
                forbidden[np.ix_(who[first], who[second])] = True
        forbidden |= forbidden.T
        return [k for k, (i, j) in enumerate(graph.pairs) if not forbidden[i, j]]

    def contradictions(self, component: Component) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Pairs of groups of cameras, by their numbers, that cannot all stand where the component says."""
        expected, shared = self.shared_points(component)
        enough = expected >= self.min_expected
        if not enough.any():
            return
        ratio = np.where(enough, shared / np.maximum(expected, 1), 0.0)
        usual = float(np.median(ratio.max(axis=1)[enough.any(axis=1)]))
        groups, expected, shared = _joined(component, expected, shared, self.min_expected, self.conflict_ratio * usual)
        within = np.diag(expected)
        due = np.maximum(self.min_overlap * np.minimum(within[:, None], within), self.min_expected)
        conflict = (expected >= due) & (shared < self.conflict_ratio * usual * expected)
        for a, b in np.argwhere(np.triu(conflict, 1)):
            yield groups[a], groups[b]

    def shared_points(self, component: Component) -> tuple[Array, Array]:
        """For each pair of cameras (n, n): points that both ought to observe, and how many of those both do."""
        n = len(component.cameras)
        observes = np.zeros((n, len(component.points)), dtype=bool)
        observes[component.obs_camera, component.obs_point] = True
        in_view = np.array([self._in_view(component, k) for k in range(n)]).reshape(observes.shape)
        gaze = component.points - component.centres[:, None]
        distance = np.linalg.norm(gaze, axis=2)
        gaze = gaze / np.maximum(distance, 1e-12)[..., None]
        size = np.array([camera.intrinsics.fx for camera in component.cameras])[:, None] / np.maximum(distance, 1e-12)
        expected, shared = np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            mine = np.flatnonzero(observes[i])
            cosine = np.einsum("npk,pk->np", gaze[:, mine], gaze[i, mine])
            alike = np.abs(np.log(size[:, mine] / size[i, mine])) < np.log(self.max_scale_ratio)
            ought = in_view[:, mine] & alike & (cosine > np.cos(np.radians(self.max_angle_deg)))
            expected[i], shared[i] = ought.sum(axis=1), (ought & observes[:, mine]).sum(axis=1)
        expected, shared = expected + expected.T, shared + shared.T
        np.fill_diagonal(expected, 0)
        np.fill_diagonal(shared, 0)
        return expected, shared

    def _in_view(self, component: Component, camera: int) -> Mask:
        i = component.cameras[camera].intrinsics
        xyz_cam = component.cameras[camera].cam_from_world.apply(component.points)
        px = np.nan_to_num(i.px_from_cam(xyz_cam), nan=-1.0)
        border_px = self.border_ratio * i.width
        return np.asarray(np.all((px > border_px) & (px < np.array([i.width, i.height]) - border_px), axis=1))


_: type[PairFilter] = ConflictFilter


def _joined(
    component: Component, expected: Array, shared: Array, min_expected: int, min_ratio: float
) -> tuple[list[NDArray[np.intp]], Array, Array]:
    """Groups of cameras joined from the strongest pair down, and the two counts (k, k) between the groups."""
    strength = _common_tracks(component)
    expected, shared = expected.copy(), shared.copy()
    group_of = np.arange(len(expected))
    rows, columns = np.nonzero(np.triu(strength, 1))
    for k in np.argsort(-strength[rows, columns], kind="stable"):
        a, b = group_of[rows[k]], group_of[columns[k]]
        if a == b or (expected[a, b] >= min_expected and shared[a, b] < min_ratio * expected[a, b]):
            continue
        group_of[group_of == b] = a
        for counts in (expected, shared):
            counts[a] += counts[b]
            counts[:, a] += counts[:, b]
            counts[b] = counts[:, b] = 0
    names = np.unique(group_of)
    between = np.ix_(names, names)
    return [np.flatnonzero(group_of == name) for name in names], expected[between], shared[between]


def _common_tracks(component: Component) -> Array:
    """Number (n, n) of points that two cameras both observe, wherever they stand."""
    sees = np.zeros((len(component.cameras), len(component.points)), np.float32)
    sees[component.obs_camera, component.obs_point] = 1
    return np.asarray(sees @ sees.T, dtype=np.float64)
