# SPDX-License-Identifier: Apache-2.0
"""Splats as SPZ: decoded by the published layout, by the reader of given models, and moved into ENU."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plyfile import PlyData
from scipy.spatial.transform import Rotation

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity
from skymoor.models.spz import splat_of_spz, spz_of_splat
from skymoor.results.placed.move import MOVERS
from skymoor.results.placed.placement import Placement

COUNT = 500


def _splat(coefficients: int = 8, reach: float = 40.0) -> NDArray[Any]:
    rng = np.random.default_rng(7)
    names = [*"xyz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(3 * coefficients)), "opacity"]
    names += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    vertex = np.zeros(COUNT, [(name, "<f4") for name in names])
    for name in names:
        limit = reach if name in "xyz" else 0.9 if name.startswith("f_") else 2.0
        vertex[name] = rng.uniform(-limit, limit, COUNT)
    for name, column in zip(
        names[-4:], Rotation.random(COUNT, random_state=3).as_quat(scalar_first=True).T, strict=True
    ):
        vertex[name] = column
    return vertex


def _columns(vertex: NDArray[Any], prefix: str, count: int) -> NDArray[np.float64]:
    return np.column_stack([vertex[f"{prefix}{k}"] for k in range(count)]).astype(np.float64)


def test_the_layout_is_the_published_one() -> None:
    vertex = _splat(0)
    data = gzip.decompress(spz_of_splat(vertex))
    magic, version, count, degree, bits = struct.unpack_from("<4sIIBB", data)
    assert (magic, version, count, degree, bits) == (b"NGSP", 3, COUNT, 0, 12)
    assert len(data) == 16 + COUNT * (9 + 1 + 3 + 3 + 4)
    raw = np.frombuffer(data, np.uint8, COUNT * 9, 16).reshape(COUNT, 3, 3)
    found = [[int.from_bytes(axis.tobytes(), "little", signed=True) / 4096 for axis in one] for one in raw]
    np.testing.assert_allclose(found, np.column_stack([vertex[a] for a in "xyz"]), atol=0.51 / 4096)
    alpha = np.frombuffer(data, np.uint8, COUNT, 16 + COUNT * 9) / 255
    np.testing.assert_allclose(alpha, 1 / (1 + np.exp(-vertex["opacity"])), atol=0.51 / 255)


@pytest.mark.parametrize("coefficients", [0, 3, 8, 15])
def test_what_is_written_is_read_to_its_precision(tmp_path: Path, coefficients: int) -> None:
    vertex = _splat(coefficients)
    (tmp_path / "s.spz").write_bytes(spz_of_splat(vertex))
    found = splat_of_spz(tmp_path / "s.spz")
    gap = np.abs(np.column_stack([found[a] - vertex[a] for a in "xyz"]))
    assert 0.1 / 4096 < gap.max() < 0.51 / 4096
    assert np.abs(_columns(found, "scale_", 3) - _columns(vertex, "scale_", 3)).max() < 0.51 / 16
    assert np.abs(_columns(found, "f_dc_", 3) - _columns(vertex, "f_dc_", 3)).max() < 0.51 / 255 / 0.15
    if coefficients:
        rest = np.abs(_columns(found, "f_rest_", 3 * coefficients) - _columns(vertex, "f_rest_", 3 * coefficients))
        assert 1e-4 < rest.max() < 0.51 / 128
    turns = [Rotation.from_quat(_columns(one, "rot_", 4), scalar_first=True) for one in (found, vertex)]
    angle = np.degrees((turns[0] * turns[1].inv()).magnitude())
    assert 0.01 < angle.max() < 0.3


def test_far_positions_have_fewer_bits_and_too_far_ones_are_refused(tmp_path: Path) -> None:
    (tmp_path / "s.spz").write_bytes(spz_of_splat(_splat(0, reach=9000.0)))
    found = splat_of_spz(tmp_path / "s.spz")
    assert 1e-4 < np.abs(found["x"] - _splat(0, reach=9000.0)["x"]).max() < 0.51 / 512
    with pytest.raises(InputError, match="do not fit into SPZ"):
        spz_of_splat(_splat(0, reach=2e7))


def test_register_moves_an_spz_into_enu_as_spz_and_ply(tmp_path: Path) -> None:
    (tmp_path / "s.spz").write_bytes(spz_of_splat(_splat(3)))
    turn = Rotation.from_euler("z", 130, degrees=True).as_matrix()
    move = Similarity(2.5, turn, np.array([30.0, -20.0, 5.0]))
    (tmp_path / "out").mkdir()
    placement = Placement.on(move, EnuFrame(46.9, 7.4, 560.0), "EPSG:32632", "CONFIRMED", 0.0)
    notes = MOVERS["spz"](tmp_path / "s.spz", tmp_path / "out", placement)
    packed, plain = splat_of_spz(tmp_path / "out" / "s.spz"), PlyData.read(tmp_path / "out" / "s.ply")["vertex"]
    given = splat_of_spz(tmp_path / "s.spz")
    want = move.apply(np.column_stack([given[a] for a in "xyz"]).astype(float))
    np.testing.assert_allclose(np.column_stack([plain[a] for a in "xyz"]), want, atol=1e-4)
    np.testing.assert_allclose(np.column_stack([packed[a] for a in "xyz"]), want, atol=0.6 / 4096)
    np.testing.assert_allclose(packed["scale_0"], given["scale_0"] + np.log(2.5), atol=0.51 / 16)
    assert "also written as PLY" in notes[0]
