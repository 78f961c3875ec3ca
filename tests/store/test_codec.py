# SPDX-License-Identifier: Apache-2.0
"""What stages exchange comes back as it was, and nothing else is made when a file is read."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skymoor.geometry.similarity import Similarity
from skymoor.registration import RegisterOptions
from skymoor.store import digest
from skymoor.store._cache import read_cache, write_cache
from skymoor.store._codec import decode, encode
from skymoor.types import Matches2D, Matches3D, Registration

SIMILARITY = Similarity(2.0, np.eye(3), np.array([1.0, 2.0, 3.0]))


def registration() -> Registration:
    mask = np.array([True, False])
    return Registration(True, "", SIMILARITY, 7, 5, rmse_m=float("nan"), inliers=mask, diagnostics={"score": 4.0})


VALUES: list[object] = [
    *(None, True, 3, 0.1 + 0.2, float("inf"), float("-inf"), "ä\n", Path("a/b")),
    *([1, [2, (3, 4)]], {"a": (1, None), 3: "b", ("x", 1): 2.5}, np.float32(0.1), np.int64(7), np.bool_(True)),
    *(np.arange(6, dtype=np.int16).reshape(2, 3), np.zeros((0, 3)), np.array(["a", "bc"]), np.array(2.5)),
    *(SIMILARITY, registration(), RegisterOptions(), [registration(), registration()]),
    Matches3D(np.ones((2, 3)), np.zeros((2, 3)), Matches2D(np.ones((2, 2)), np.zeros((2, 2)), np.ones(2))),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_values_come_back_with_their_types(value: object, tmp_path: Path) -> None:
    write_cache(tmp_path / "a.npz", None, value)
    _, back = read_cache(tmp_path / "a.npz")
    assert type(back) is type(value)
    assert digest(back) == digest(value)


def test_not_a_number_comes_back(tmp_path: Path) -> None:
    write_cache(tmp_path / "a.npz", None, [float("nan"), np.float64("nan")])
    _, back = read_cache(tmp_path / "a.npz")
    assert all(np.isnan(back)) and [type(item) for item in back] == [float, np.float64]


def test_an_array_that_occurs_twice_is_kept_once() -> None:
    x = np.zeros(1000)
    tree, arrays = encode({"a": x, "b": [x]})
    assert len(arrays) == 1
    back = decode(json.loads(json.dumps(tree)), arrays)
    assert back["a"] is back["b"][0]


@pytest.mark.parametrize("value", [object(), {1, 2}, lambda: 1, np.array([None]), 1j, RegisterOptions])
def test_what_cannot_be_kept_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="cannot be kept"):
        encode([value])


@pytest.mark.parametrize(
    "tree",
    [
        {"object": ["os:system", {"command": "true"}]},
        {"object": ["subprocess:Popen", {"args": "true"}]},
        {"object": ["skymoor.store._run:os", {}]},
        {"object": ["skymoor.store._codec:import_module", {"name": "os"}]},
        {"object": ["skymoor.types:no_progress", {}]},
        {"object": ["skymoor.errors:InputError", {}]},
        {"object": ["skymoor.none:Nothing", {}]},
        {"object": ["skymoor.types:Registration", {"unknown": 1}]},
        {"unknown": 1},
        {"a": 1, "b": 2},
    ],
)
def test_a_file_can_make_nothing_but_our_dataclasses(tree: Any) -> None:
    with pytest.raises((ValueError, TypeError, LookupError, ImportError)):
        decode(tree, [])


def test_every_field_of_what_stages_exchange_is_kept() -> None:
    tree, arrays = encode(registration())
    (name, state) = tree["object"]
    assert name == "skymoor.types.registrations:Registration"
    assert set(state) == {item.name for item in fields(Registration)}
    assert is_dataclass(decode(tree, arrays))
