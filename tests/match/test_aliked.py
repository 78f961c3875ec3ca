# SPDX-License-Identifier: Apache-2.0
"""ALIKED and LoFTR with random weights, saved and read as trained ones are; what is trained is measured elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import skymoor.engines.aliked
import skymoor.match._loftr
from skymoor.errors import InputError
from skymoor.match import AlikedMatcher, CyclicOptions, LoftrMatcher, cyclic_matches, match_hypothesis
from skymoor.types import Matches2D, Raster, Warp
from support.pictures import noise_picture

Array = NDArray[np.float64]
ALL = CyclicOptions(max_matches=10**6)


def raster(picture: NDArray[np.uint8]) -> Raster:
    return Raster(picture, np.ones(picture.shape[:2], bool))


def returning(warp: Warp) -> Matches2D:
    return cyclic_matches(warp, ALL, rng=np.random.default_rng(0))


@pytest.fixture
def feature() -> Any:
    import kornia.feature

    return kornia.feature


@pytest.fixture
def aliked(feature: Any, tmp_path: Path) -> AlikedMatcher:
    torch.manual_seed(0)
    network = feature.ALIKED("aliked-n16rot")
    tensors = {name: x for name, x in network.state_dict().items() if name != "dkd.hw_grid"}  # as it is published
    torch.save(tensors, tmp_path / "aliked.pth")
    return AlikedMatcher(weights=str(tmp_path / "aliked.pth"), device="cpu", max_keypoints=400)


class TestAliked:
    def test_shifted_picture(self, aliked: AlikedMatcher) -> None:
        """By a multiple of what the network reduces by, it sees the same, trained or not."""
        whole = noise_picture((224, 288))
        a, b = raster(whole[:192, :256].copy()), raster(whole[32:224, 32:288].copy())
        found = returning(aliked(a, b))
        error = found.px_b - found.px_a + 32
        right = np.linalg.norm(error, axis=1) < 0.1
        assert right.sum() > 50 and right.mean() > 0.4  # near the border it does not see the same
        assert np.mean(np.linalg.norm(error - 8, axis=1) < 2) < 0.05
        assert (found.confidence == 1).all()

    def test_through_a_placement(self, aliked: AlikedMatcher) -> None:
        whole = noise_picture((256, 320))
        a, b = raster(whole[48:176, 64:224].copy()), raster(whole)
        matrix = np.array([[1.0, 0, 64], [0, 1, 48]])
        found, _ = match_hypothesis(a, b, matrix, aliked, ALL, rng=np.random.default_rng(0))
        assert len(found) > 50
        assert np.median(np.linalg.norm(found.px_b - found.px_a - [64, 48], axis=1)) < 0.1

    def test_masked_points_do_not_count(self, aliked: AlikedMatcher) -> None:
        picture = noise_picture((128, 192))
        a, b = raster(picture), raster(picture.copy())
        a.mask[:, :96] = False
        found = returning(aliked(a, b))
        assert len(found) > 20 and found.px_a[:, 0].min() > 96 + 4

    def test_empty_picture(self, aliked: AlikedMatcher) -> None:
        a, b = raster(noise_picture((96, 96))), raster(noise_picture((96, 96)))
        b.mask[:] = False
        assert len(returning(aliked(a, b))) == 0

    def test_weights_of_another_network(self, feature: Any, tmp_path: Path) -> None:
        torch.save(feature.ALIKED("aliked-t16").state_dict(), tmp_path / "t16.pth")
        with pytest.raises(InputError, match=r"t16\.pth: weights of another network"):
            AlikedMatcher(weights=str(tmp_path / "t16.pth"))(*2 * [raster(noise_picture((64, 64)))])


class TestLoftr:
    @pytest.fixture
    def loftr(self, feature: Any, tmp_path: Path) -> LoftrMatcher:
        torch.manual_seed(0)
        content = {"state_dict": feature.LoFTR(pretrained=None).state_dict()}
        torch.save(content, tmp_path / "loftr.ckpt")
        return LoftrMatcher(weights=str(tmp_path / "loftr.ckpt"), device="cpu")

    def test_pictures_of_two_shapes(self, loftr: LoftrMatcher) -> None:
        a, b = raster(noise_picture((100, 140))), raster(noise_picture((90, 64)))
        warp = loftr(a, b)
        assert warp.b_from_a.shape == (100, 140, 2) and warp.confidence_b.shape == (90, 64)
        assert np.isfinite(warp.b_from_a).all() and 0 <= warp.confidence_a.min() <= warp.confidence_a.max() <= 1


class Pixels:
    """A network that finds the bright pixels of a picture, counted as kornia counts: from the first one's centre."""

    def keypoints(self, images: torch.Tensor) -> torch.Tensor:
        return torch.nonzero(images[0].mean(dim=0) > 0.5)[:, [1, 0]].float()

    def __call__(self, images: Any) -> Any:
        if isinstance(images, dict):  # as LoFTR, whose pixels are counted from the first one's corner
            points = [self.keypoints(images[f"image{k}"]) + 0.5 for k in (0, 1)]
            return {"keypoints0": points[0], "keypoints1": points[1], "confidence": torch.full((len(points[0]),), 0.7)}
        points = self.keypoints(images)
        return [SimpleNamespace(keypoints=points, descriptors=torch.eye(len(points), 128))]


def blocks(shape: tuple[int, int], corners: Array, side: int) -> Raster:
    picture = np.zeros((*shape, 3), np.uint8)
    for u, v in corners.astype(int):
        picture[v : v + side, u : u + side] = 255
    return raster(picture)


@pytest.mark.parametrize("side", [1, 4])
def test_pixels_of_kornia_to_ours(side: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Middles of bright blocks come out where they are, also of pictures that the network sees reduced."""
    corners = np.array([[16, 24], [40, 24], [24, 48], [72, 56]]) * side
    shape_b = (88 * side, 104 * side)
    shape_a = shape_b if side > 1 else (80, 96)
    a, b = blocks(shape_a, corners, side), blocks(shape_b, corners + 8 * side, side)
    fake = SimpleNamespace(match_smnn=lambda x, y, _: (None, torch.arange(4)[:, None].repeat(1, 2)))
    monkeypatch.setitem(sys.modules, "kornia", SimpleNamespace(feature=fake))
    monkeypatch.setitem(sys.modules, "kornia.feature", fake)
    for module in (skymoor.engines.aliked, skymoor.match._loftr):
        monkeypatch.setattr(module, "_network", lambda *_: Pixels())
        monkeypatch.setattr(module, "find", lambda *_: Path("unused"))
    for matcher in (AlikedMatcher(side_px=104, device="cpu"), LoftrMatcher(side_px=104, device="cpu")):
        warp = matcher(a, b)
        rows, columns = np.nonzero(warp.confidence_a)
        px_a = np.column_stack([columns, rows]) + 0.5
        np.testing.assert_allclose(px_a, np.floor(corners + side / 2) + 0.5)
        np.testing.assert_allclose(warp.b_from_a[rows, columns] - px_a, 8.0 * side, atol=1e-4)


@pytest.mark.parametrize(
    "make",
    [lambda: AlikedMatcher(max_ratio=1.5), lambda: AlikedMatcher(max_ratio=0.0), lambda: LoftrMatcher(side_px=8)],
)
def test_options_out_of_range(make: Callable[[], object]) -> None:
    with pytest.raises(InputError, match=r"max_ratio|side_px"):
        make()
