# SPDX-License-Identifier: Apache-2.0
"""3D Tiles against the rules of their specification; meshes are read by trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from skymoor.results.formats.tiles import CELLS, Surface, write_tiles
from skymoor.types import Array
from support.exported_run import FRAME


def _surface(rows: int = 300, columns: int = 420) -> Surface:
    """Rolling ground of 0.5 m with a hole."""
    u, v = np.meshgrid(np.arange(columns) * 0.5, np.arange(rows) * -0.5)
    points = np.dstack([u, v, 10 + 3 * np.sin(u / 15) + v / 40])
    known = np.ones((rows, columns), bool)
    known[100:120, 50:90] = False
    return Surface(points, np.full((rows, columns, 3), (200, 100, 50), np.uint8), known)


@pytest.fixture(scope="module")
def tileset(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("tiles")
    content = write_tiles(_surface(), FRAME, lambda name, data: (folder / name).write_bytes(data) and None)  # type: ignore[func-returns-value]
    assert content is not None
    return folder, content


def _tiles(tile: dict[str, Any], level: int = 0) -> list[tuple[int, dict[str, Any]]]:
    below = [one for child in tile.get("children", ()) for one in _tiles(child, level + 1)]
    return [(level, tile), *below]


def _bounds(tile: dict[str, Any]) -> tuple[Array, Array]:
    box = np.array(tile["boundingVolume"]["box"])
    half = np.diag(box[3:].reshape(3, 3))
    return box[:3] - half, box[:3] + half


def _enu(path: Path) -> tuple[Array, Array, Array]:
    """Vertices, faces and colours of a .glb; viewers turn y up to z up."""
    (mesh,) = trimesh.load_scene(path, process=False).geometry.values()
    colours = np.asarray(mesh.visual.vertex_attributes["color"])
    return np.asarray(mesh.vertices)[:, [0, 2, 1]] * [1, -1, 1], mesh.faces, colours


def test_every_tile_keeps_the_rules_of_the_specification(tileset: tuple[Path, dict[str, Any]]) -> None:
    folder, content = tileset
    assert content["asset"]["version"] == "1.1" and content["geometricError"] >= content["root"]["geometricError"]
    tiles = _tiles(content["root"])
    assert {level for level, _ in tiles} == {0, 1, 2} and len(tiles) == 1 + 4 + 12
    for level, tile in tiles:
        low, high = _bounds(tile)
        assert tile["refine"] == "REPLACE" and (high > low).all()
        if level == 2:
            assert "children" not in tile and tile["geometricError"] == 0
        else:
            assert tile["geometricError"] == pytest.approx(0.5 * 2 ** (2 - level))  # halves at each level
        for child in tile.get("children", ()):
            inner_low, inner_high = _bounds(child)
            assert child["geometricError"] < tile["geometricError"]
            assert (inner_low >= low - 1e-6).all() and (inner_high <= high + 1e-6).all()
        vertices, faces, _ = _enu(folder / tile["content"]["uri"])
        assert len(faces) and len(vertices) <= (CELLS + 3) ** 2
        assert (vertices >= low - 1e-3).all() and (vertices <= high + 1e-3).all()
    assert {tile["content"]["uri"] for _, tile in tiles} == {path.name for path in folder.iterdir()}
    assert "transform" in content["root"] and not any("transform" in tile for _, tile in tiles[1:])


@pytest.mark.parametrize("level", [0, 1, 2])
def test_every_level_shows_the_whole_surface_to_its_error(tileset: tuple[Path, dict[str, Any]], level: int) -> None:
    folder, content = tileset
    nodes = []
    for _, tile in [one for one in _tiles(content["root"]) if one[0] == level]:
        vertices, _, colours = _enu(folder / tile["content"]["uri"])
        up = 10 + 3 * np.sin(vertices[:, 0] / 15) + vertices[:, 1] / 40
        top = np.abs(vertices[:, 2] - up) < 1e-3
        skirt = 0.5 * 2 ** (2 - level)
        np.testing.assert_allclose(up[~top] - vertices[~top, 2], skirt, atol=1e-3)
        assert 0 < (~top).mean() < 0.2 and len({tuple(one) for one in colours.tolist()}) == 1
        nodes.append(vertices[top, :2])
    found = np.unique(np.round(np.concatenate(nodes), 3), axis=0)
    step = 2 ** (2 - level)
    want = _surface().coarsened(step)
    assert len(found) >= 0.99 * want.known.sum() and len(found) <= want.known.sum()


def test_colours_are_means_of_known_ones_in_coarse_levels() -> None:
    striped = _surface()
    striped.known[:] = True
    striped.colours[:, ::2] = 0
    mean = striped.coarsened(4).colours[10:-10, 10:-10]
    np.testing.assert_allclose(mean.reshape(-1, 3), [[100, 50, 25]] * (mean.size // 3), atol=1)
    dark = _surface()
    dark.colours[~dark.known] = 0
    coarse = dark.coarsened(4)
    assert (coarse.colours[coarse.known] == (200, 100, 50)).all()  # what is not known does not darken its neighbours


def test_where_nothing_is_known_there_are_no_tiles() -> None:
    empty = Surface(np.zeros((5, 5, 3)), np.zeros((5, 5, 3), np.uint8), np.zeros((5, 5), bool))
    assert write_tiles(empty, FRAME, lambda *_: None) is None
