# SPDX-License-Identifier: Apache-2.0
"""A photo of a wrong pose contradicts the rendering of the others' depth maps, whatever its own depths are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skymoor.densify import AgreementOptions, check_poses
from skymoor.geometry import Similarity
from skymoor.ground.walls import transformed_depth_map
from skymoor.types import DepthMap
from support.houses import from_the_air, houses

ASIDE = Similarity(1.0, np.eye(3), np.array([9.0, -6.0, 0.0]))


@pytest.fixture(scope="module")
def maps() -> list[DepthMap]:
    return from_the_air(houses(1))


def blind(depth_map: DepthMap) -> DepthMap:
    unknown = np.full_like(depth_map.depth, np.nan)
    return replace(depth_map, depth=unknown, sigma=unknown)


def test_photos_of_right_poses_agree(maps: list[DepthMap]) -> None:
    checks = check_poses([blind(maps[0]), *maps[1:]])
    assert [check.image for check in checks] == [depth_map.camera.image for depth_map in maps]
    assert not any(check.contradicts for check in checks)
    assert min(check.ncc or 0.0 for check in checks) > 0.8
    assert all(0.3 < check.covered <= 1 for check in checks)


@pytest.mark.parametrize("wrong", [(0,), (3, 4)])
@pytest.mark.parametrize("measured", [True, False])
def test_photos_of_wrong_poses_contradict_even_if_they_agree_with_each_other(
    maps: list[DepthMap], wrong: tuple[int, ...], measured: bool
) -> None:
    moved = [transformed_depth_map(m, ASIDE) if k in wrong else m for k, m in enumerate(maps)]
    shown = [m if measured or k not in wrong else blind(m) for k, m in enumerate(moved)]
    checks = check_poses(shown)
    assert tuple(k for k, check in enumerate(checks) if check.contradicts) == wrong
    assert min(check.ncc or 0.0 for k, check in enumerate(checks) if k not in wrong) > 0.75


def test_without_texture_or_overlap_nothing_is_tested(maps: list[DepthMap]) -> None:
    rng = np.random.default_rng(0)
    plain = [replace(m, rgb=rng.integers(120, 126, m.rgb.shape, np.uint8)) for m in maps]
    assert all(check.ncc is None and not check.contradicts for check in check_poses(plain))
    alone = check_poses(maps[:1])
    assert (alone[0].ncc, alone[0].covered, alone[0].contradicts) == (None, 0.0, False)
    assert check_poses([]) == []
    far = transformed_depth_map(maps[0], Similarity(1.0, np.eye(3), np.array([5000.0, 0.0, 0.0])))
    assert check_poses([far, *maps[1:]])[0].ncc is None


def test_sparser_points_give_the_same_result(maps: list[DepthMap]) -> None:
    full, few = (check_poses(maps, AgreementOptions(dense_maps=count)) for count in (100, 3))
    np.testing.assert_allclose([w.ncc for w in full], [w.ncc for w in few], atol=0.12)
