# SPDX-License-Identifier: Apache-2.0
"""Tiny networks with random weights, in folders as a model hub publishes them; and what can be wrong with those."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skymoor.errors import InputError


def save(network: Any, folder: Path, processor: dict[str, Any] | None = None) -> Path:
    """The folder of a network and of how pictures are prepared for it."""
    network.save_pretrained(folder)
    if processor is not None:
        (folder / "preprocessor_config.json").write_text(json.dumps(processor))
    return folder


def assert_refuses_bad_folders(call: Callable[[str], object], good: Path, bad: Path, *, lost: str) -> None:
    """`call` takes the path of a folder; `good` is copied to `bad` and spoiled in several ways.

    `lost` is a part of the name of a tensor that the network cannot do without.
    """
    with pytest.raises(InputError, match="there are no weights here"):
        call(str(bad))
    bad.mkdir()
    with pytest.raises(InputError, match=r"not the folder of a model, it has no config\.json"):
        call(str(bad))
    for spoil, message in (
        (_truncate, r"cannot be read \(.*\); is it the right folder, and whole"),
        (_halve, r"weights of another network \(lacks \S*" + lost),
        (_remove, r"cannot be read \(.*\); is it the right folder, and whole"),
        (_scribble, r"config\.json: not JSON, or cut off"),
        (_another, r"holds a model of type bert, not|cannot be read"),
    ):
        shutil.rmtree(bad)
        shutil.copytree(good, bad)
        spoil(bad, lost)
        with pytest.raises(InputError, match=message) as caught:
            call(str(bad))
        assert "\n" not in str(caught.value) and str(bad) in str(caught.value)


def _weights(folder: Path) -> Path:
    return folder / "model.safetensors"


def _truncate(folder: Path, _: str) -> None:
    _weights(folder).write_bytes(_weights(folder).read_bytes()[:-100])


def _halve(folder: Path, lost: str) -> None:
    from safetensors.torch import load_file, save_file

    tensors = load_file(_weights(folder))
    kept = {name: tensor for name, tensor in tensors.items() if lost not in name}
    assert len(kept) < len(tensors)
    save_file(kept, _weights(folder), {"format": "pt"})


def _remove(folder: Path, _: str) -> None:
    _weights(folder).unlink()


def _scribble(folder: Path, _: str) -> None:
    (folder / "config.json").write_text('{"model_type": ')


def _another(folder: Path, _: str) -> None:
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"model_type": "bert"}))
