# SPDX-License-Identifier: Apache-2.0
"""Detection of similar scenes mistaken for one (doppelgangers), by missing common observations.

A reconstruction that has merged two similar buildings fits its observations, and no residual in it is large. But
cameras that are side by side in it and have the same direction share few observations: each observes the cars, trees
and neighbours of its own scene. Missing correspondences as evidence are the idea of Zach, Irschara and Bischof (CVPR
2008); their detection in a finished, possibly folded reconstruction, and the split of its cameras, that of Heinly, Dunn
and Frahm (ECCV 2014).

Those compare image segments. Here only tracks are counted: of the points that one camera observes, another one at
nearly the same direction and distance should observe a share; the usual share is estimated from each camera's best
partner in the set. Cameras are then grouped from the strongest pair downwards, but never two groups that share far
fewer points than expected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skymoor.reconstruct.graph import common_points
from skymoor.reconstruct.protocol import PairFilter, ViewGraph
from skymoor.types import Array, Component, Mask


@dataclass(frozen=True)
class ConflictFilter:
    """Drops the pairs between groups of photos that a first reconstruction has wrongly merged.

    Attributes:
        max_angle_deg: between two cameras' rays to a point that both should observe.
        max_scale_ratio: between the image scales at the point.
        border_ratio: of the width, along the border of a photo where nothing is expected.
        min_expected: pairs with fewer expected points are not tested.
        min_overlap: nor are groups whose expected common points are a smaller share than this of those within the
            smaller group: corners of buildings hide points that a camera beyond them should see.
        conflict_ratio: two groups contradict each other if they share less than this part of the usual share.
        rounds: of testing and mapping again; a new reconstruction may show further contradictions.
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
            photo_of = np.array([index[camera.image] for camera in component.cameras])
            for first, second in self.contradictions(component):
                forbidden[np.ix_(photo_of[first], photo_of[second])] = True
        forbidden |= forbidden.T
        return [k for k, (i, j) in enumerate(graph.pairs) if not forbidden[i, j]]

    def contradictions(self, component: Component) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Pairs of groups of cameras, by their numbers, whose positions in the component contradict each other."""
        expected, shared = self.shared_points(component)
        enough = expected >= self.min_expected
        if not enough.any():
            return
        ratio = np.where(enough, shared / np.maximum(expected, 1), 0.0)
        usual = float(np.median(ratio.max(axis=1)[enough.any(axis=1)]))
        groups, expected, shared = _joined(component, expected, shared, self.min_expected, self.conflict_ratio * usual)
        within = np.diag(expected)
        min_common = np.maximum(self.min_overlap * np.minimum(within[:, None], within), self.min_expected)
        conflict = (expected >= min_common) & (shared < self.conflict_ratio * usual * expected)
        for a, b in np.argwhere(np.triu(conflict, 1)):
            yield groups[a], groups[b]

    def shared_points(self, component: Component) -> tuple[Array, Array]:
        """For each pair of cameras (n, n): points that both should observe, and how many of those both do."""
        n = len(component.cameras)
        observes = np.zeros((n, len(component.points)), dtype=bool)
        observes[component.obs_camera, component.obs_point] = True
        in_view = np.array([self._in_view(component, k) for k in range(n)]).reshape(observes.shape)
        rays = component.points - component.centres[:, None]
        distance = np.linalg.norm(rays, axis=2)
        rays = rays / np.maximum(distance, 1e-12)[..., None]
        size = np.array([camera.intrinsics.fx for camera in component.cameras])[:, None] / np.maximum(distance, 1e-12)
        expected, shared = np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            own = np.flatnonzero(observes[i])
            cosine = np.einsum("npk,pk->np", rays[:, own], rays[i, own])
            same_scale = np.abs(np.log(size[:, own] / size[i, own])) < np.log(self.max_scale_ratio)
            visible = in_view[:, own] & same_scale & (cosine > np.cos(np.radians(self.max_angle_deg)))
            expected[i], shared[i] = visible.sum(axis=1), (visible & observes[:, own]).sum(axis=1)
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
    strength = common_points(component)
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
