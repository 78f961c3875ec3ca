# SPDX-License-Identifier: Apache-2.0
"""RoMa's family: what the libraries answer, in pixels. The networks themselves: test_roma_networks."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import skymoor.match._roma
import skymoor.match._romav2
from skymoor.errors import BackendUnavailable, InputError
from skymoor.match import CyclicOptions, RomaMatcher, RomaV2Matcher, TinyRomaMatcher, cyclic_matches, match_hypothesis
from skymoor.types import Matches2D, Raster, Warp
from support.pictures import noise_picture

Array = NDArray[np.float64]
ALL = CyclicOptions(max_matches=10**6)
SHAPE_A, SHAPE_B = (90, 160), (130, 110)
MATRIX = np.array([[0.6, 0.05, 4.0], [-0.04, 1.3, 6.0]])  # px of b from px of a
BACK = np.linalg.inv(np.vstack([MATRIX, [0, 0, 1]]))[:2]


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    for cached in (skymoor.match._roma._roma, skymoor.match._roma._tiny_roma, skymoor.match._romav2._network):
        cached.cache_clear()


def raster(shape: tuple[int, int]) -> Raster:
    return Raster(noise_picture(shape), np.ones(shape, bool))


def answer(matrix: Array, source: tuple[int, int], target: tuple[int, int], grid: tuple[int, int]) -> torch.Tensor:
    """(h, w, 4) as RoMa says it: own place and place in the other picture, from -1 to 1."""
    y, x = torch.meshgrid(*((2 * torch.arange(n) + 1) / n - 1 for n in grid), indexing="ij")
    px = (torch.stack([x, y], dim=-1).double() + 1) / 2 * torch.tensor([source[1], source[0]])
    there = px @ torch.from_numpy(matrix[:, :2].T.copy()) + torch.from_numpy(matrix[:, 2].copy())
    there = there / torch.tensor([target[1], target[0]]) * 2 - 1
    return torch.cat([torch.stack([x, y], dim=-1).double(), there], dim=-1).float()


class FakeRoma:
    """Knows the truth, and says it as romatch 0.1.2 says it."""

    def __init__(self, **options: Any) -> None:
        self.options = options

    def match(self, a: Any, b: Any, device: str) -> tuple[torch.Tensor, torch.Tensor]:
        assert (a.size, b.size, device) == (SHAPE_A[::-1], SHAPE_B[::-1], "cpu")
        grid = (64, 64)
        there, back = answer(MATRIX, SHAPE_A, SHAPE_B, grid), answer(BACK, SHAPE_B, SHAPE_A, grid)
        both = torch.cat([there, back[..., [2, 3, 0, 1]]], dim=1)[None]
        return both, torch.cat([torch.full(grid, 0.8), torch.full(grid, 0.6)], dim=1)[None]


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[FakeRoma]:
    """romatch with `FakeRoma` in it, and files that can be read."""
    made: list[FakeRoma] = []

    def roma_outdoor(**options: Any) -> FakeRoma:
        made.append(FakeRoma(**options))
        return made[-1]

    monkeypatch.setitem(sys.modules, "romatch", SimpleNamespace(roma_outdoor=roma_outdoor))
    monkeypatch.setitem(sys.modules, "loguru", SimpleNamespace(logger=SimpleNamespace(disable=lambda _: None)))
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path))
    (tmp_path / "roma").mkdir()
    for k, name in enumerate(("roma_outdoor.pth", "dinov2_vitl14_pretrain.pth")):
        torch.save({"weight": torch.full((2,), float(k))}, tmp_path / "roma" / name)
    return made


def returning(warp: Warp) -> Matches2D:
    return cyclic_matches(warp, ALL, rng=np.random.default_rng(0))


def assert_true(warp: Warp) -> None:
    centres = [np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1) for h, w in (SHAPE_A, SHAPE_B)]
    for flow, px, matrix in zip((warp.b_from_a, warp.a_from_b), centres, (MATRIX, BACK), strict=True):
        error = np.linalg.norm(flow - px @ matrix[:, :2].T - matrix[:, 2], axis=-1)
        assert error[2:-2, 2:-2].max() < 0.01


class TestRoma:
    def test_both_halves_of_the_answer(self, fake: list[FakeRoma]) -> None:
        warp = RomaMatcher(device="cpu")(raster(SHAPE_A), raster(SHAPE_B))
        assert_true(warp)
        assert warp.confidence_a.max() == pytest.approx(0.8) and warp.confidence_b.max() == pytest.approx(0.6)
        found = returning(warp)
        assert len(found) > 5000
        assert np.abs(found.px_b - found.px_a @ MATRIX[:, :2].T - MATRIX[:, 2]).max() < 0.3

    def test_made_once_with_the_weights_and_sizes(self, fake: list[FakeRoma]) -> None:
        for _ in range(2):
            RomaMatcher(device="cpu", coarse_px=280, upsample_px=0)(raster(SHAPE_A), raster(SHAPE_B))
        (made,) = fake
        assert made.options["weights"]["weight"][0] == 0 and made.options["dinov2_weights"]["weight"][0] == 1
        assert made.options["coarse_res"] == 280 and not made.options["upsample_preds"]
        assert made.options["symmetric"] and not made.options["use_custom_corr"]

    def test_through_a_placement(self, fake: list[FakeRoma], monkeypatch: pytest.MonkeyPatch) -> None:
        """What `match_hypothesis` lays has the sizes of b, and comes back in pixels of a."""
        seen: list[tuple[int, int]] = []

        def match(_: FakeRoma, a: Any, b: Any, device: str) -> tuple[torch.Tensor, torch.Tensor]:
            seen.extend([a.size, b.size])
            same = answer(np.eye(2, 3), b.size[::-1], b.size[::-1], (64, 64))
            return torch.cat([same, same[..., [2, 3, 0, 1]]], dim=1)[None], torch.full((1, 64, 128), 0.9)

        monkeypatch.setattr(FakeRoma, "match", match)
        turned = np.array([[0.0, -0.5, 80.0], [0.5, 0.0, 20.0]])
        found, _ = match_hypothesis(
            raster(SHAPE_A), raster(SHAPE_B), turned, RomaMatcher(device="cpu"), ALL, rng=np.random.default_rng(0)
        )
        assert seen[0] == seen[1] != SHAPE_A[::-1]
        assert 0.9 * 45 * 80 < len(found) <= 45 * 80
        np.testing.assert_allclose(found.px_b, found.px_a @ turned[:, :2].T + turned[:, 2], atol=0.02)

    def test_weights_not_fetched(self, fake: list[FakeRoma], tmp_path: Path) -> None:
        (tmp_path / "roma/dinov2_vitl14_pretrain.pth").unlink()
        with pytest.raises(BackendUnavailable, match=r"dinov2_vitl14_pretrain\.pth.*skymoor weights fetch roma"):
            RomaMatcher(device="cpu")(raster(SHAPE_A), raster(SHAPE_B))

    def test_sizes_that_the_network_cannot_take(self) -> None:
        for options in ({"coarse_px": 500}, {"coarse_px": 0}, {"upsample_px": 100}, {"upsample_px": -8}):
            with pytest.raises(InputError, match=rf"{next(iter(options))} = .*multiple of"):
                RomaMatcher(**options)  # type: ignore[arg-type]
        with pytest.raises(InputError, match="side_px = 32"):
            TinyRomaMatcher(side_px=32)


class FakeV2(torch.nn.Module):
    """Says what romav2 2.0.1 says; its weights and DINOv3 come through PyTorch's hub, as there."""

    def __init__(self, cfg: Any) -> None:
        super().__init__()
        url = "https://github.com/Parskatt/RoMaV2/releases/download/v2.0.1/romav2.0.1.pt"
        tensors = torch.hub.load_state_dict_from_url(url, map_location="cpu")
        commit = skymoor.match._romav2.DINOV3[-40:]
        self.f = torch.hub.load(f"facebookresearch/dinov3:{commit}", "dinov3_vitl16", skip_validation=True)
        self.setting, self.bidirectional = cfg, False
        self.load_state_dict(tensors)

    def match(self, a: NDArray[np.uint8], b: NDArray[np.uint8]) -> dict[str, torch.Tensor]:
        assert self.bidirectional and a.shape[:2] == SHAPE_A and b.shape[:2] == SHAPE_B
        grid = (64, 64)
        there, back = answer(MATRIX, SHAPE_A, SHAPE_B, grid), answer(BACK, SHAPE_B, SHAPE_A, grid)
        sure = torch.full((1, *grid, 1), 0.7)
        return {"warp_AB": there[None, ..., 2:], "warp_BA": back[None, ..., 2:], "overlap_AB": sure, "overlap_BA": sure}


class TestRomaV2:
    @pytest.fixture
    def matcher(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RomaV2Matcher:
        library = ModuleType("romav2")
        FakeV2.Cfg = lambda setting: setting  # type: ignore[attr-defined]
        library.RoMaV2 = FakeV2  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "romav2", library)
        torch.save(torch.nn.Sequential().state_dict() | {"f.weight": torch.ones(1, 1)}, tmp_path / "romav2.0.1.pt")
        (tmp_path / "dinov3").mkdir()
        code = "import torch\n\ndef dinov3_vitl16():\n    return torch.nn.Linear(1, 1, bias=False)\n"
        (tmp_path / "dinov3/hubconf.py").write_text(code)
        return RomaV2Matcher(accept_dinov3_licence=True, weights=str(tmp_path / "romav2.0.1.pt"))

    def test_flows_and_the_hub(self, matcher: RomaV2Matcher, capfd: pytest.CaptureFixture[str]) -> None:
        before = torch.hub.get_dir()
        warp = matcher(raster(SHAPE_A), raster(SHAPE_B))
        assert_true(warp)
        assert warp.confidence_a.max() == pytest.approx(0.7)
        assert torch.hub.get_dir() == before
        assert capfd.readouterr() == ("", "")

    def test_the_licence_comes_first(self) -> None:
        with pytest.raises(BackendUnavailable, match=r"DINOv3.*licence.*accept_dinov3_licence"):
            RomaV2Matcher()(raster(SHAPE_A), raster(SHAPE_B))

    def test_without_dinov3s_code(self, matcher: RomaV2Matcher, tmp_path: Path) -> None:
        (tmp_path / "dinov3/hubconf.py").unlink()
        with pytest.raises(BackendUnavailable, match=r"dinov3: DINOv3's code at commit adc254450"):
            matcher(raster(SHAPE_A), raster(SHAPE_B))
        elsewhere = RomaV2Matcher(accept_dinov3_licence=True, weights=matcher.weights, dinov3=str(tmp_path))
        with pytest.raises(InputError, match=r"no hubconf\.py"):
            elsewhere(raster(SHAPE_A), raster(SHAPE_B))
