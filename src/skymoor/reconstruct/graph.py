# SPDX-License-Identifier: Apache-2.0
"""Which photos have what in common: the verified matches of a COLMAP database, without filtered pairs, and points."""

from __future__ import annotations

import numpy as np
import pycolmap
from scipy.sparse import csr_array

from skymoor.reconstruct.protocol import PairFilter, ViewGraph, colmap_name
from skymoor.types import Array, Component, Photos


def view_graph(database: pycolmap.Database, photos: Photos, components: tuple[Component, ...]) -> ViewGraph:
    """All pairs of photos with verified matches; see `ViewGraph`."""
    photo_of = _photo_of(database, photos)
    keypoints = {i: np.asarray(database.read_keypoints(i), np.float64)[:, :2] for i in photo_of}
    pairs, matches = [], []
    for pair_id, geometry in zip(*database.read_two_view_geometries(), strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair_id)
        index = np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)
        if len(index):
            pairs.append((photo_of[first], photo_of[second]))
            matches.append(np.hstack([keypoints[first][index[:, 0]], keypoints[second][index[:, 1]]]))
    return ViewGraph(photos, tuple(pairs), tuple(matches), components)


def drop_pairs(
    database: pycolmap.Database, photos: Photos, components: tuple[Component, ...], pair_filter: PairFilter
) -> int:
    """Delete the verified matches of the pairs that the filter does not keep; returns the number of these pairs."""
    graph = view_graph(database, photos, components)
    image_of = {photo: image_id for image_id, photo in _photo_of(database, photos).items()}
    kept = set(pair_filter(graph))
    dropped = [pair for k, pair in enumerate(graph.pairs) if k not in kept]
    for i, j in dropped:
        database.delete_two_view_geometry(image_of[i], image_of[j])
    return len(dropped)


def _photo_of(database: pycolmap.Database, photos: Photos) -> dict[int, int]:
    """Photo number by image id."""
    number = {colmap_name(k, size): k for k, size in enumerate(photos.sizes)}
    return {image.image_id: number[image.name] for image in database.read_all_images()}


def common_points(component: Component) -> Array:
    """Number (n, n) of points that two cameras both observe, regardless of their poses."""
    shape = (len(component.cameras), max(len(component.points), 1))
    observes = csr_array((np.ones(len(component.obs_camera)), (component.obs_camera, component.obs_point)), shape=shape)
    observes.data[:] = 1.0  # a point counts once in a photo
    return np.asarray((observes @ observes.T).toarray(), dtype=np.float64)
