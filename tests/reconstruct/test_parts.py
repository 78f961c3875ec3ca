# SPDX-License-Identifier: Apache-2.0
"""Parts of a model that hardly any points hold together are models of their own; others stay whole."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from skymoor.engines.colmap import colmap_from_component
from skymoor.reconstruct.calibration import calibrate
from skymoor.reconstruct.parts import MIN_SHARED, parts_of, without_photos
from support.walks import reconstructed, walk, wall_points


def joined_by(points: int, photos: int = 8) -> pycolmap.Reconstruction:
    """A walk whose first five photos have only so many points in common with the others."""
    model = colmap_from_component(reconstructed(walk(photos), wall_points(400)))
    ids = sorted(model.reg_image_ids())
    first, common = set(ids[:5]), 0
    for number, (key, point) in enumerate(list(model.points3D.items())):
        seen = [(element.image_id, element.point2D_idx) for element in point.track.elements]
        sides = [one for one in seen if one[0] in first], [one for one in seen if one[0] not in first]
        if not all(sides):
            continue
        if common < points:
            common += 1
            continue
        for image_id, index in sides[number % 2]:
            if model.exists_point3D(key):
                model.delete_observation(image_id, index)
    return model


def names_of(model: pycolmap.Reconstruction) -> set[str]:
    return {model.image(i).name for i in model.reg_image_ids()}


@pytest.mark.parametrize("points", [0, MIN_SHARED - 1])
def test_parts_with_hardly_a_common_point_are_cut(points: int) -> None:
    model = joined_by(points)
    ids = sorted(model.reg_image_ids())
    first, second = parts_of(model, 3)
    assert names_of(first) == {model.image(i).name for i in ids[:5]}
    assert names_of(second) == {model.image(i).name for i in ids[5:]}
    for part in (first, second):
        assert len(part.points3D) > 20 and all(point.track.length() >= 2 for point in part.points3D.values())
        assert np.isfinite(calibrate(part).focal_px)


def test_a_model_that_is_held_together_stays_as_it_is() -> None:
    model = joined_by(200)
    assert parts_of(model, 3) == [model]


def test_photos_of_few_points_stay_with_the_part_they_have_most_with() -> None:
    """A part of fewer photos than a component needs is none."""
    model = joined_by(MIN_SHARED - 1)
    assert parts_of(model, 4) == [model]
    lonely = joined_by(MIN_SHARED - 1, photos=12)
    ids = sorted(lonely.reg_image_ids())
    observed = [k for k, point in enumerate(lonely.image(ids[0]).points2D) if point.has_point3D()]
    for index in observed[MIN_SHARED - 5 :]:
        lonely.delete_observation(ids[0], index)
    assert lonely.image(ids[0]).num_points3D == MIN_SHARED - 5
    assert {len(names_of(part)) for part in parts_of(lonely, 3)} == {5, 7}


def test_photos_are_left_out_without_a_trace() -> None:
    model = joined_by(200)
    ids = sorted(model.reg_image_ids())
    left = without_photos(model, ids[:2])
    assert len(left.images) == len(left.reg_image_ids()) == len(ids) - 2
    assert len(model.reg_image_ids()) == len(ids)
    assert np.isfinite(calibrate(left).focal_sigma_ratio)
