# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from skymoor.reconstruct import ViewGraph
from skymoor.reconstruct.graph import drop_pairs, view_graph
from skymoor.reconstruct.protocol import colmap_name
from skymoor.types import Image, Photos

SIZES = ((640, 480), (300, 200), (640, 480))


def unread(name: str) -> Image:
    raise AssertionError(name)


PHOTOS = Photos(("x", "y", "z"), SIZES, unread)


@pytest.fixture
def database(tmp_path: Path) -> pycolmap.Database:
    """Photos entered in another order than their own, all pairs matched."""
    rng = np.random.default_rng(0)
    with pycolmap.Database.open(tmp_path / "database.db") as db:
        ids = {}
        for k in (2, 0, 1):
            width, height = SIZES[k]
            camera = pycolmap.Camera.create_from_model_name(0, "PINHOLE", 500.0, width, height)
            name = colmap_name(k, SIZES[k])
            ids[k] = db.write_image(pycolmap.Image(name=name, camera_id=db.write_camera(camera)))
            db.write_keypoints(ids[k], (100 * k + rng.uniform(size=(5, 2))).astype(np.float32))
        for i, j in ((0, 1), (0, 2), (1, 2)):
            geometry = pycolmap.TwoViewGeometry()
            geometry.inlier_matches = np.array([[0, 1], [3, 2]], np.uint32)
            db.write_two_view_geometry(ids[i], ids[j], geometry)
    return pycolmap.Database.open(tmp_path / "database.db")


def test_matches_are_pixels_of_the_photos_that_the_pair_names(database: pycolmap.Database) -> None:
    graph = view_graph(database, PHOTOS, ())
    assert sorted(tuple(sorted(pair)) for pair in graph.pairs) == [(0, 1), (0, 2), (1, 2)]
    for (i, j), matches in zip(graph.pairs, graph.matches, strict=True):
        assert matches.shape == (2, 4)
        np.testing.assert_array_equal(np.floor(matches[:, 0] / 100), i)
        np.testing.assert_array_equal(np.floor(matches[:, 2] / 100), j)


def test_pairs_that_the_filter_does_not_keep_are_gone(database: pycolmap.Database) -> None:
    def without_x_and_z(graph: ViewGraph) -> list[int]:
        return [k for k, pair in enumerate(graph.pairs) if set(pair) != {0, 2}]

    assert drop_pairs(database, PHOTOS, (), without_x_and_z) == 1
    assert sorted(tuple(sorted(pair)) for pair in view_graph(database, PHOTOS, ()).pairs) == [(0, 1), (1, 2)]
    assert drop_pairs(database, PHOTOS, (), without_x_and_z) == 0


def test_no_pairs_no_graph(tmp_path: Path) -> None:
    with pycolmap.Database.open(tmp_path / "empty.db") as db:
        graph = view_graph(db, PHOTOS, ())
    assert graph.pairs == () and graph.matches == ()
