# SPDX-License-Identifier: Apache-2.0
"""Photos of several lenses among airborne photos of one size, told apart by the scale of what they have in common.

Photos of a flight that share a camera show the ground at nearly one scale. Where some show it much larger, they are
from much lower or through a longer lens: matches in the image alone cannot say which. So the photos are reconstructed
once more with a camera for each group of scales, and relief decides: from lower, heights displace points more. Where
a camera that is shared explains the same points clearly worse, the groups have lenses of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from skymoor.reconstruct.database import new_camera, stored
from skymoor.reconstruct.lenses import Lens
from skymoor.reconstruct.protocol import ViewGraph, colmap_name
from skymoor.types import Array, Photos

Index = NDArray[np.int64]

GAP = float(np.log(1.3))
"""Between two groups of scales. Flying heights of one flight vary by less, or else continuously; lenses of one
drone differ by a factor of 2 or more."""
MIN_MATCHES = 15
"""Of a pair whose scale counts: COLMAP's least number of verified matches."""
MIN_GROUP = 2
"""A smaller group has no say: one photo of wrong matches would be one."""
DISTANT_PX = 20.0
"""Distance of two points of a photo whose ratio is a scale."""
DRAWS = 500
ROUNDS = 10


@dataclass(frozen=True)
class ScaleGroup:
    """Photos of one size that show the ground at one scale, by their numbers.

    `ratio` is their scale in units of that of the largest group which they are compared with, `reference` its place in
    the list of groups; 1 and its own place for that group itself.
    """

    photos: tuple[int, ...]
    ratio: float
    reference: int


def scale_groups(graph: ViewGraph) -> list[ScaleGroup]:
    """Groups of photos of different scales, each largest group before those compared with it; empty if all are alike.

    A photo's scale is estimated from those of all its pairs (least absolute deviations, by reweighted least squares).
    Photos are compared where matches connect them.
    """
    pairs, ratios, weights = _pair_scales(graph)
    log_scale = _photo_scales(len(graph.photos), pairs, ratios, weights)
    groups: list[ScaleGroup] = []
    for connected in _connected(len(graph.photos), pairs):
        for size in sorted({graph.photos.sizes[k] for k in connected}):
            alike = np.array(sorted((k for k in connected if graph.photos.sizes[k] == size), key=log_scale.__getitem__))
            cuts = np.flatnonzero(np.diff(log_scale[alike]) > GAP) + 1
            parts = [part for part in np.split(alike, cuts) if len(part) >= MIN_GROUP]
            parts.sort(key=lambda part: -len(part))
            middles = [float(np.median(log_scale[part])) for part in parts]
            if len(parts) > 1:
                groups += [
                    ScaleGroup(tuple(sorted(part.tolist())), float(np.exp(middle - middles[0])), reference)
                    for part, middle, reference in zip(parts, middles, [len(groups)] * len(parts), strict=True)
                ]
    return groups


def copy_with_cameras(database: Path, copy: Path, photos: Photos, groups: Sequence[ScaleGroup]) -> list[Lens]:
    """A database of the same key points and verified matches, in which each group of photos has a camera of its own.

    Other photos keep a camera of their size. Returns the cameras of the groups that are not the largest of theirs.
    """
    group_of = {k: number for number, group in enumerate(groups) for k in group.photos}
    cameras: dict[tuple[int, tuple[int, int]], tuple[int, int]] = {}
    with pycolmap.Database.open(database) as old, pycolmap.Database.open(copy) as new:
        ids = {}
        for k, size in enumerate(photos.sizes):
            name, number = colmap_name(k, size), group_of.get(k, -1)
            if (number, size) not in cameras:
                largest = number < 0 or groups[number].reference == number
                # A few photos determine no second radial term.
                cameras[number, size] = new_camera(new, "RADIAL" if largest else "SIMPLE_RADIAL", size)
            camera_id, rig_id = cameras[number, size]
            before = stored(old, name).image_id
            ids[before] = new.write_image(pycolmap.Image(name=name, camera_id=camera_id))
            frame = pycolmap.Frame(rig_id=rig_id)
            frame.add_data_id(new.read_image(ids[before]).data_id)
            new.write_frame(frame)
            new.write_keypoints(ids[before], old.read_keypoints(before))
        for pair_id, geometry in zip(*old.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            new.write_two_view_geometry(ids[first], ids[second], geometry)
    camera_of = {number: camera_id for (number, _), (camera_id, _) in cameras.items()}
    compared = [(number, group) for number, group in enumerate(groups) if group.reference != number]
    return [Lens(camera_of[number], camera_of[group.reference], group.ratio) for number, group in compared]


def _pair_scales(graph: ViewGraph) -> tuple[Index, Array, Array]:
    """Pairs (n, 2), log of the second photo's scale in units of the first's (n,), and numbers of matches (n,)."""
    rng = np.random.default_rng(0)
    pairs, ratios, weights = [], [], []
    for pair, matches in zip(graph.pairs, graph.matches, strict=True):
        if len(matches) < MIN_MATCHES:
            continue
        a, b = rng.integers(len(matches), size=(2, DRAWS))
        gap = matches[a] - matches[b]
        first, second = np.linalg.norm(gap[:, :2], axis=1), np.linalg.norm(gap[:, 2:], axis=1)
        distant = (first > DISTANT_PX) & (second > DISTANT_PX)
        if distant.any():
            pairs.append(pair)
            ratios.append(float(np.median(np.log(second[distant] / first[distant]))))
            weights.append(len(matches))
    return np.array(pairs, np.int64).reshape(-1, 2), np.array(ratios), np.array(weights, float)


def _photo_scales(n: int, pairs: Index, ratios: Array, weights: Array) -> Array:
    """Log scale of each photo (n,), up to one constant for photos that are connected."""
    design = np.zeros((len(pairs), n))
    rows = np.arange(len(pairs))
    design[rows, pairs[:, 1]], design[rows, pairs[:, 0]] = 1.0, -1.0
    scales: Array = np.zeros(n)
    robust: Array = np.ones(len(pairs))
    for _ in range(ROUNDS):
        weight = np.sqrt(weights * robust)[:, None]
        scales = np.asarray(np.linalg.lstsq(weight * design, weight[:, 0] * ratios, rcond=None)[0])
        robust = np.asarray(1 / np.maximum(np.abs(design @ scales - ratios), 0.01))
    return scales


def _connected(n: int, pairs: Index) -> list[list[int]]:
    """Photos of two or more that pairs connect."""
    edges = csr_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, label = connected_components(edges, directed=False)
    groups = [np.flatnonzero(label == k).tolist() for k in range(count)]
    return [group for group in groups if len(group) > 1]
