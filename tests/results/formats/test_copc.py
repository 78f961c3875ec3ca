# SPDX-License-Identifier: Apache-2.0
"""COPC, read by laspy."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
from laspy.copc import Bounds, CopcReader

from skymoor.results.formats import pointcloud_las
from skymoor.results.formats.copc import CELLS, LEAF_POINTS, octree, write_copc
from support.exported_run import FRAME

pytest.importorskip("copclib")


def _ordered(xyz: object) -> np.ndarray:  # type: ignore[type-arg]
    rows = np.asarray(xyz)
    return rows[np.lexsort(rows.T)]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A cloud of 150,000 points, of which half are on a house, and the same as COPC."""
    folder, rng = tmp_path_factory.mktemp("copc"), np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(-100, 100, (75_000, 2)), rng.normal(0, 0.1, 75_000)])
    house = np.column_stack([rng.uniform(20, 30, (75_000, 2)), rng.uniform(0, 8, 75_000)])
    xyz = np.concatenate([ground, house])
    colours = rng.integers(0, 255, (len(xyz), 3), np.uint8)
    plain, ordered = folder / "a.laz", folder / "a.copc.laz"
    plain.write_bytes(pointcloud_las(xyz, colours, FRAME, "EPSG:32719"))
    write_copc(plain, ordered, np.random.default_rng(0))
    return plain, ordered


def test_copc_holds_every_point_once_with_its_colour(files: tuple[Path, Path]) -> None:
    plain = laspy.read(files[0])
    with CopcReader.open(str(files[1])) as reader:
        points = reader.query()
        np.testing.assert_allclose(reader.header.mins, plain.header.mins)
        np.testing.assert_allclose(reader.header.maxs, plain.header.maxs)
    assert len(points) == len(plain.points) == 150_000
    columns = [
        np.column_stack([cloud.X, cloud.Y, cloud.Z, cloud.red, cloud.green, cloud.blue]) for cloud in (plain, points)
    ]
    np.testing.assert_array_equal(_ordered(columns[0]), _ordered(columns[1]))
    as_laz = laspy.read(files[1])  # plain readers of LAZ read it too
    assert as_laz.header.parse_crs() == plain.header.parse_crs()
    assert (len(as_laz.points), as_laz.header.generating_software) == (150_000, "skymoor")


def test_copc_gives_a_part_by_place_and_by_resolution(files: tuple[Path, Path]) -> None:
    plain = laspy.read(files[0])
    xyz = np.asarray(plain.xyz)
    low, high = np.median(xyz[75_000:], axis=0)[:2] - 2, np.median(xyz[75_000:], axis=0)[:2] + 2
    with CopcReader.open(str(files[1])) as reader:
        part = reader.query(bounds=Bounds(mins=low, maxs=high))
        coarse = reader.query(level=0)
        spacing = reader.copc_info.spacing
    inside = ((xyz[:, :2] >= low) & (xyz[:, :2] <= high)).all(axis=1)
    assert len(part) == inside.sum() > 5000
    assert 5_000 < len(coarse) < 40_000  # one a cell of 1.6 m, of 150,000
    assert spacing == pytest.approx((xyz.max(axis=0) - xyz.min(axis=0)).max() / CELLS, rel=1e-3)


def test_points_at_one_place_do_not_deepen_the_tree_for_ever() -> None:
    xyz = np.zeros((LEAF_POINTS + 100, 3))
    found = list(octree(xyz, np.array([-1.0, -1, -1]), 2.0, np.random.default_rng(0)))
    assert sum(len(chosen) for _, chosen in found) == len(xyz)
    for (depth, *key), chosen in found:
        assert all(0 <= one < 2**depth for one in key) and len(chosen)
