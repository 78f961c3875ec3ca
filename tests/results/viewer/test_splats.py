# SPDX-License-Identifier: Apache-2.0
"""Gaussians of a file as the viewer takes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.results.read import Result
from skymoor.results.viewer.scene import parts_of
from skymoor.results.viewer.splats import Splats, read_splats
from support.finished import finished_run

plyfile = pytest.importorskip("plyfile", reason="plyfile is not installed: pip install skymoor[models]")
NAMES = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity")
NAMES += ("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")


def write_splat(path: Path, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Gaussians of known sizes that are turned about the vertical; returns their places and covariances."""
    rng = np.random.default_rng(3)
    xyz, sizes = (
        rng.uniform(-20, 20, (count, 3)),
        np.tile([0.5, 0.2, 0.1], (count, 1)) * np.linspace(1, 2, count)[:, None],
    )
    turn = Rotation.from_rotvec(np.linspace(0, 3, count)[:, None] * [0.0, 0.0, 1.0])
    columns = [
        xyz,
        np.full((count, 3), 0.5),
        np.full((count, 1), 2.0),
        np.log(sizes),
        3 * turn.as_quat(scalar_first=True),
    ]
    rows = np.zeros(count, [(name, "f4") for name in NAMES])
    for name, column in zip(NAMES, np.concatenate(columns, axis=1).T, strict=True):
        rows[name] = column
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write(str(path))
    matrices = turn.as_matrix()
    return xyz, matrices @ (np.eye(3) * sizes[:, None, :] ** 2) @ np.swapaxes(matrices, 1, 2)


def test_places_sizes_and_directions_are_those_of_the_file(tmp_path: Path) -> None:
    xyz, covariances = write_splat(tmp_path / "a.ply")
    found = read_splats(tmp_path / "a.ply")
    assert found is not None
    np.testing.assert_allclose(found.centres, xyz, atol=1e-4)
    np.testing.assert_allclose(found.covariances, covariances, atol=1e-4)
    np.testing.assert_allclose(found.opacity, 1 / (1 + np.exp(-2.0)), atol=1e-5)
    np.testing.assert_allclose(found.rgb, 0.5 + 0.5 * 0.2820948, atol=1e-5)


def test_the_largest_are_kept_where_there_are_too_many(tmp_path: Path) -> None:
    xyz, _ = write_splat(tmp_path / "a.ply")
    found = read_splats(tmp_path / "a.ply", most=15)
    assert found is not None
    np.testing.assert_allclose(found.centres, xyz[25:], atol=1e-4)


def test_a_run_shows_its_splats_and_tells_what_it_cannot_read(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    (run / "placed").mkdir()
    write_splat(run / "placed" / "a.ply")
    (run / "placed" / "b.ply").write_text("no splat")
    parts = list(parts_of(Result.read(run)))
    assert [part.name for part in parts if isinstance(part, Splats)] == ["a"]
    assert [part for part in parts if isinstance(part, str) and "b.ply" in part]
