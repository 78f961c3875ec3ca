# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from skymoor.engines.libraries import require, torch_device
from skymoor.errors import BackendUnavailable

LEARNED = ("transformers", "diffusers", "kornia", "romatch", "romav2", "huggingface_hub", "torchvision", "safetensors")


def test_what_is_there() -> None:
    assert require("numpy.linalg", "none") is np.linalg


def test_what_is_missing_and_how_to_get_it() -> None:
    with pytest.raises(BackendUnavailable, match=r'no_such_library.*pip install "skymoor\[roma\]"$'):
        require("no_such_library", "roma")


def test_what_is_there_and_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_library.py").write_text("raise RuntimeError('operator does not exist\\nsecond line')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BackendUnavailable, match=r"broken_library cannot be imported \(operator does not exist\)"):
        require("broken_library", "roma")
    assert "broken_library" not in sys.modules


@pytest.mark.parametrize("module", ["skymoor", "skymoor.cli.main", "skymoor.cli.commands"])
def test_learned_engines_cost_nothing_until_they_are_called(module: str) -> None:
    """Neither the command nor what it does imports their libraries."""
    ask = f"import sys, {module}; print(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "skymoor" in loaded and loaded.isdisjoint(LEARNED)


def test_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    assert torch_device("cpu") == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert torch_device("auto") == "cpu"
    with pytest.raises(BackendUnavailable, match="no CUDA device"):
        torch_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert torch_device("auto") == torch_device("cuda") == "cuda"
    with pytest.raises(BackendUnavailable, match="device = gpu"):
        torch_device("gpu")
