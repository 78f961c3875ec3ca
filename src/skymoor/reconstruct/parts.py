# SPDX-License-Identifier: Apache-2.0
"""Models that are cut where hardly any points hold their parts together, and models without some of their photos.

Structure from motion joins parts of a scene by whatever tracks they share. A handful, often mistaken ones between
structures that look alike, do not determine how two parts lie to each other: each is right by itself, and the whole is
warped, with small residuals. Parts that are registered separately lose nothing but a relation that was not known.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from skymoor.engines.temporary import temporary_folder

MIN_SHARED = 15  # points of two photos that hold them together: what COLMAP asks of the matches of a pair


def parts_of(model: pycolmap.Reconstruction, min_photos: int) -> list[pycolmap.Reconstruction]:
    """The parts of a model that no two photos with `MIN_SHARED` common points hold together, the largest first.

    Photos that have too few points with each single photo stay with the part that they have most with, so that parts
    have at least `min_photos`.
    """
    ids = sorted(model.reg_image_ids())
    shared = _shared_points(model, ids)
    count, part_of = connected_components(csr_array(shared >= MIN_SHARED), directed=False)
    sizes = np.bincount(part_of, minlength=count)
    whole = np.flatnonzero(sizes >= min_photos)
    if len(whole) < 2:
        return [model]
    with_part = np.stack([shared[:, part_of == part].sum(axis=1) for part in whole], axis=1)
    nearest = np.where(np.isin(part_of, whole), part_of, whole[with_part.argmax(axis=1)])
    largest_first = sorted(whole.tolist(), key=lambda part: -int(np.count_nonzero(nearest == part)))
    return [
        without_photos(model, [i for i, own in zip(ids, nearest.tolist(), strict=True) if own != part])
        for part in largest_first
    ]


def without_photos(model: pycolmap.Reconstruction, images: Collection[int]) -> pycolmap.Reconstruction:
    """A copy without some of the images, by their ids.

    It is written and read again: images that are only no longer registered make the covariance of an adjustment fail.
    """
    copy = pycolmap.Reconstruction(model)
    for i in images:
        copy.deregister_frame(copy.image(i).frame_id)
    with temporary_folder() as folder:
        copy.write(folder)
        return pycolmap.Reconstruction(folder)


def _shared_points(model: pycolmap.Reconstruction, ids: list[int]) -> NDArray[np.int64]:
    """How many points each two of the images have in common, (n, n), zero on the diagonal."""
    index = {i: k for k, i in enumerate(ids)}
    rows, columns = [], []
    for number, point in enumerate(model.points3D.values()):
        seen = {index[element.image_id] for element in point.track.elements if element.image_id in index}
        rows += sorted(seen)
        columns += [number] * len(seen)
    seen_by = csr_array((np.ones(len(rows), np.int64), (rows, columns)), shape=(len(ids), max(len(model.points3D), 1)))
    shared: NDArray[np.int64] = (seen_by @ seen_by.T).toarray()
    np.fill_diagonal(shared, 0)
    return shared
