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
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from skymoor.engines.colmap import component_from_colmap
from skymoor.engines.temporary import temporary_folder
from skymoor.reconstruct.graph import common_points

MIN_SHARED = 15  # points of two photos that hold them together: what COLMAP asks of the matches of a pair


def parts_of(model: pycolmap.Reconstruction, min_photos: int) -> list[pycolmap.Reconstruction]:
    """The parts of a model that no two photos with `MIN_SHARED` common points hold together.

    Photos that have too few points with each single photo stay with the part that they have most with, so that parts
    have at least `min_photos`.
    """
    ids = sorted(model.reg_image_ids())
    shared = common_points(component_from_colmap(model, {model.image(i).name: str(i) for i in ids}))
    count, part_of = connected_components(csr_array(shared >= MIN_SHARED), directed=False)
    sizes = np.bincount(part_of, minlength=count)
    whole = np.flatnonzero(sizes >= min_photos)
    if len(whole) < 2:
        return [model]
    with_part = np.stack([shared[:, part_of == part].sum(axis=1) for part in whole], axis=1)
    nearest = np.where(np.isin(part_of, whole), part_of, whole[with_part.argmax(axis=1)])
    return [
        without_photos(model, [i for i, own in zip(ids, nearest.tolist(), strict=True) if own != part])
        for part in whole.tolist()
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
