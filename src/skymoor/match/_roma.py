# SPDX-License-Identifier: Apache-2.0
"""RoMa, the paper's matcher, and Tiny RoMa, through the library romatch.

Edstedt et al., RoMa: Robust Dense Feature Matching, CVPR 2024. The coarse features are those of DINOv2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skymoor.engines.batches import BatchMatcher, Pair
from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.tensors import as_tensor, fitted
from skymoor.engines.weights import another_network, find, load_into, load_state_dict
from skymoor.errors import InputError
from skymoor.match.flow import EngineFlow, warp_from_flows
from skymoor.match.protocol import DenseMatcher
from skymoor.types import Raster, Warp

if TYPE_CHECKING:
    import torch

GRID_PX = 56  # DINOv2 uses patches of 14 pixels; the finer network halves three times
TINY_PX = 32


@dataclass(frozen=True)
class RomaMatcher:
    """RoMa (outdoor model): a flow and its certainty for every pixel, in both directions. A GPU is recommended.

    Attributes:
        weights, dinov2: paths of roma_outdoor.pth and dinov2_vitl14_pretrain.pth; empty for where
            `skymoor weights fetch roma` puts them.
        device: "auto", "cpu" or "cuda"; half precision on CUDA only.
        coarse_px: side of the squares, in pixels, to which both images are resized for the coarse matching.
        upsample_px: side of the squares for the refinement; 0 skips it, in a third of the time.
        pairs_at_once: batch size; 0 for eight on CUDA and one on a CPU.
    """

    weights: str = ""
    dinov2: str = ""
    device: str = field(default="auto", metadata=FIXED)
    coarse_px: int = 560
    upsample_px: int = 864
    pairs_at_once: int = 0

    def __post_init__(self) -> None:
        if self.coarse_px < GRID_PX or self.coarse_px % GRID_PX:
            raise InputError(f"coarse_px = {self.coarse_px}: must be a multiple of {GRID_PX}, such as 560")
        if self.upsample_px < 0 or self.upsample_px % 8:
            raise InputError(f"upsample_px = {self.upsample_px}: must be a multiple of 8, such as 864, or 0")

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; raises as `__call__` where something is missing."""
        require("romatch", "roma")
        weights = find("roma", "roma_outdoor.pth", self.weights)
        return weights, find("roma", "dinov2_vitl14_pretrain.pth", self.dinov2)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match in both directions; see `DenseMatcher`.

        Raises:
            BackendUnavailable: romatch or the weights are missing.
            InputError: the weights are not RoMa's.
        """
        device = torch_device(self.device)
        network = _roma(*self.ready(), device, self.coarse_px, self.upsample_px)
        from PIL import Image

        warp, certainty = network.match(Image.fromarray(a.rgb), Image.fromarray(b.rgb), device=device)
        return _both_ways((a, b), warp[0], certainty[0])

    def many(self, pairs: Iterable[Pair]) -> Iterator[Warp]:
        """The warp of each pair, in batches; see `BatchMatcher`. Raises the same errors as a call."""
        device = torch_device(self.device)
        batch_size = self.pairs_at_once or (8 if device == "cuda" else 1)
        remaining = iter(pairs)
        while batch := list(islice(remaining, batch_size)):
            yield from self._match_batch(batch, device) if len(batch) > 1 else (self(*batch[0]),)

    def _match_batch(self, pairs: Sequence[Pair], device: str) -> Iterator[Warp]:
        import torch
        from PIL import Image

        network = _roma(*self.ready(), device, self.coarse_px, self.upsample_px)
        prepare = require("romatch.utils", "roma").get_tuple_transform_ops

        def stacked(side_px: int) -> list[torch.Tensor]:
            ready = [prepare(resize=(side_px, side_px), normalize=True)(pair) for pair in images]
            return [torch.stack([prepared[k] for prepared in ready]).to(device) for k in (0, 1)]

        images = [tuple(Image.fromarray(raster.rgb) for raster in pair) for pair in pairs]
        fine = stacked(self.upsample_px) if self.upsample_px else [None, None]
        warp, certainty = network.match(
            *stacked(self.coarse_px), im_A_high_res=fine[0], im_B_high_res=fine[1], device=device
        )
        yield from (_both_ways(pair, warp[k], certainty[k]) for k, pair in enumerate(pairs))


@dataclass(frozen=True)
class TinyRomaMatcher:
    """Tiny RoMa (outdoor model): flow from XFeat features (Potje et al., CVPR 2024), in seconds on a CPU.

    Attributes:
        weights: path of tiny_roma_v1_outdoor.pth; empty for where `skymoor weights fetch tiny-roma` puts it.
        device: "auto", "cpu" or "cuda".
        side_px: larger images are reduced to about this long side, in pixels; memory grows with its fourth power.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    side_px: int = 640

    def __post_init__(self) -> None:
        if self.side_px < 2 * TINY_PX:
            raise InputError(f"side_px = {self.side_px}: Tiny RoMa needs at least {2 * TINY_PX}")

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; raises as `__call__` where something is missing."""
        require("romatch", "roma")
        return (find("tiny-roma", "tiny_roma_v1_outdoor.pth", self.weights),)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match in both directions; see `DenseMatcher`.

        Raises:
            BackendUnavailable: romatch, kornia or the weights are missing.
            InputError: the weights are not tiny RoMa's.
        """
        device = torch_device(self.device)
        network = _tiny_roma(*self.ready(), device)
        images = [as_tensor(fitted(raster.rgb, self.side_px, TINY_PX)[0], device) for raster in (a, b)]
        # The network matches in one direction only.
        flows = []
        for source, target in (images, images[::-1]):
            warp, certainty = network.match(source, target)
            flows.append(EngineFlow(_numpy(warp[0, ..., 2:]), _numpy(certainty[0])))
        return warp_from_flows(a, b, *flows)


_: tuple[type[DenseMatcher], ...] = (RomaMatcher, TinyRomaMatcher)
_batches: type[BatchMatcher] = RomaMatcher


def _both_ways(pair: Pair, warp: torch.Tensor, certainty: torch.Tensor) -> Warp:
    """The warp of one pair, from the network's outputs (h, 2 w, 4) and (h, 2 w): both directions side by side."""
    width = warp.shape[1] // 2
    forward = EngineFlow(_numpy(warp[:, :width, 2:]), _numpy(certainty[:, :width]))
    backward = EngineFlow(_numpy(warp[:, width:, :2]), _numpy(certainty[:, width:]))
    return warp_from_flows(*pair, forward, backward)


@lru_cache(maxsize=1)
def _roma(weights: Path, dinov2: Path, device: str, coarse_px: int, upsample_px: int) -> Any:
    """The network, once per process and configuration: it is 1.6 GB."""
    tensors, backbone = load_state_dict(weights), load_state_dict(dinov2)
    romatch = _import_quietly("romatch")

    def build() -> Any:
        return romatch.roma_outdoor(
            device=device,
            weights=tensors,
            dinov2_weights=backbone,
            coarse_res=coarse_px,
            upsample_res=upsample_px or None,
            upsample_preds=upsample_px > 0,
            symmetric=True,
            # An optional CUDA kernel; PyTorch's fallback computes the same.
            use_custom_corr=device == "cuda" and find_spec("local_corr") is not None,
        )

    return _name_misfit(build, {"DinoVisionTransformer": dinov2, "": weights})


@lru_cache(maxsize=1)
def _tiny_roma(weights: Path, device: str) -> Any:
    romatch = _import_quietly("romatch")
    features = require("kornia.feature.xfeat", "roma").XFeatModel()
    network = romatch.models.model_zoo.tiny_roma_v1_model(weights=None, xfeat=features)
    load_into(network, weights)
    return network.to(device).eval()


def _import_quietly(module: str) -> Any:
    """Import the library with its log output disabled: stages print nothing."""
    library = require(module, "roma")
    require("loguru", "roma").logger.disable(module)
    return library


def _name_misfit(build: Callable[[], Any], files: dict[str, Path]) -> Any:
    """Return `build()`; if weights do not fit the network, raise an error that names their file."""
    try:
        return build()
    except RuntimeError as error:
        if "state_dict" not in str(error):
            raise
        path = next(path for network, path in files.items() if network in str(error))
        raise another_network(path, error) from None


def _numpy(values: torch.Tensor) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.asarray(values.float().cpu().numpy(), np.float32)
