# SPDX-License-Identifier: Apache-2.0
"""The real networks of RoMa and tiny RoMa with random weights, which are saved, found and read as trained ones are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import skymoor.match._roma
from skymoor.errors import InputError
from skymoor.match import RomaMatcher, TinyRomaMatcher
from skymoor.types import Raster, Warp
from support.pictures import noise_picture
from support.torchvision_parts import draw_nothing, romatch_library

A = Raster(noise_picture((90, 160)), np.ones((90, 160), bool))
B = Raster(noise_picture((130, 110)), np.ones((130, 110), bool))


@pytest.fixture
def romatch(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    with romatch_library(monkeypatch) as library:
        yield library
    skymoor.match._roma._roma.cache_clear()
    skymoor.match._roma._tiny_roma.cache_clear()


def assert_answers(matcher: RomaMatcher | TinyRomaMatcher, capfd: pytest.CaptureFixture[str]) -> tuple[Warp, Warp]:
    """With random weights the flow is noise: of the right shapes, and the same whichever picture is first.

    Returns the answers for A with B and for B with A.
    """
    capfd.readouterr()
    warp, swapped = matcher(A, B), matcher(B, A)
    assert capfd.readouterr() == ("", "")
    assert warp.b_from_a.shape == (90, 160, 2) and warp.a_from_b.shape == (130, 110, 2)
    for flow, same, confidence in (
        (warp.b_from_a, swapped.a_from_b, warp.confidence_a),
        (warp.a_from_b, swapped.b_from_a, warp.confidence_b),
    ):
        assert np.isfinite(flow).all() and flow.std() > 1
        assert 0 <= confidence.min() < confidence.max() <= 1
        np.testing.assert_allclose(flow, same, atol=1e-2)
    return warp, swapped


def test_tiny_roma(romatch: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from kornia.feature.xfeat import XFeatModel

    torch.manual_seed(0)
    network = romatch.models.model_zoo.tiny_roma_v1_model(xfeat=XFeatModel())
    torch.save(network.state_dict(), tmp_path / "tiny.pth")
    assert_answers(TinyRomaMatcher(str(tmp_path / "tiny.pth"), "cpu", side_px=160), capfd)


def random_of(shapes: dict[str, Tensor]) -> dict[str, Tensor]:
    """Random tensors of these shapes: views of a few numbers, so that a file of them is a hundredth of its size."""
    numbers = 0.02 * torch.randn(1 << 21)

    def one(name: str, like: Tensor) -> Tensor:
        if like.ndim < 2:  # biases, and what normalises
            return torch.full(like.shape, float(name.endswith(("weight", "running_var"))), dtype=like.dtype)
        inner = torch.empty(like.shape[1:], device="meta").stride()
        return numbers.as_strided(like.shape, (17, *inner))

    return {name: one(name, like) for name, like in shapes.items()}


@pytest.fixture
def roma_files(romatch: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """roma_outdoor.pth and DINOv2's file, in the full size of the networks: 415 million numbers."""
    from romatch.models.matcher import RegressionMatcher
    from romatch.models.transformer import vit_large

    class Stop(Exception):
        pass

    shapes: dict[str, Tensor] = {}

    def look(network: Any, *_: Any) -> None:
        shapes.update(network.state_dict())
        raise Stop

    torch.manual_seed(0)
    with monkeypatch.context() as patch, torch.device("meta"):  # shapes without numbers
        patch.setattr(torch, "linspace", partial(torch.linspace, device="cpu"))  # DINOv2 reads it
        patch.setattr(RegressionMatcher, "load_state_dict", look)
        dinov2 = vit_large(img_size=518, patch_size=14, init_values=1.0, ffn_layer="mlp", block_chunks=0).state_dict()
        with pytest.raises(Stop):
            romatch.roma_outdoor("meta", weights={}, dinov2_weights=dinov2, use_custom_corr=False)
    assert sum(tensor.numel() for part in (shapes, dinov2) for tensor in part.values()) > 4.1e8
    torch.save(random_of(shapes), tmp_path / "roma.pth")
    torch.save(random_of(dinov2), tmp_path / "dinov2.pth")
    draw_nothing(monkeypatch)
    return {"weights": str(tmp_path / "roma.pth"), "dinov2": str(tmp_path / "dinov2.pth")}


def test_roma(roma_files: dict[str, str], capfd: pytest.CaptureFixture[str]) -> None:
    matcher = RomaMatcher(**roma_files, device="cpu", coarse_px=56, upsample_px=64)
    first, second = assert_answers(matcher, capfd)
    together = replace(matcher, pairs_at_once=2)
    pairs = iter([(A, B), (B, A), (A, B)])
    for alone, warp in zip([first, second, first], together.many(pairs), strict=True):
        np.testing.assert_allclose(warp.b_from_a, alone.b_from_a, atol=2e-2)
        np.testing.assert_allclose(warp.confidence_b, alone.confidence_b, atol=1e-3)
    skymoor.match._roma._roma.cache_clear()
    with pytest.raises(InputError, match=r"dinov2\.pth: weights of another network \(Missing key"):
        RomaMatcher(roma_files["dinov2"], roma_files["dinov2"], "cpu")(A, B)
