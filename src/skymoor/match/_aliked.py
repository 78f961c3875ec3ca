# SPDX-License-Identifier: Apache-2.0
"""ALIKED key points, through the library kornia: a learned matcher for CPUs.

Zhao et al., ALIKED: A Lighter Keypoint and Descriptor Extraction Network via Deformable Transformation, 2023.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skymoor.errors import InputError
from skymoor.match._engines import as_tensor, fitted, inner
from skymoor.match.flow import warp_from_pairs
from skymoor.match.protocol import DenseMatcher
from skymoor.optional import require, torch_device
from skymoor.types import Array, Raster, Warp
from skymoor.weights import find, load_into

if TYPE_CHECKING:
    import torch

BORDER_PX = 4  # of the mask: closer to it the network sees the edge of what is known


@dataclass(frozen=True)
class AlikedMatcher:
    """Key points that are each other's nearest by their descriptions; the warp is sure there and nowhere else.

    Attributes:
        weights: path of aliked-n16rot.pth; empty for where `skymoor weights fetch aliked` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: the surest so many of each picture.
        max_ratio: a match must be closer than this share of the distance to the next best, both ways; 1 asks for
            nothing beyond being each other's nearest.
        side_px: larger pictures are reduced to this long side.
    """

    weights: str = ""
    device: str = "auto"
    max_keypoints: int = 4096
    max_ratio: float = 0.98
    side_px: int = 1600

    def __post_init__(self) -> None:
        if not 0 < self.max_ratio <= 1:
            raise InputError(f"max_ratio = {self.max_ratio}: a share between 0 and 1")

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; see `__call__` for what is raised where something is missing."""
        require("kornia.feature", "kornia")
        return (find("aliked", "aliked-n16rot.pth", self.weights),)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match both ways; see `DenseMatcher`. The confidence of a match is 1: it has passed the tests.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of ALIKED n16rot.
        """
        device = torch_device(self.device)
        network = _network(*self.ready(), device, self.max_keypoints)
        (px_a, described_a), (px_b, described_b) = (self._keypoints(network, raster, device) for raster in (a, b))
        _, pairs = require("kornia.feature", "kornia").match_smnn(described_a, described_b, self.max_ratio)
        i, j = pairs.cpu().numpy().T
        return warp_from_pairs(a, b, px_a[i], px_b[j], np.ones(len(i)))

    def _keypoints(self, network: Any, raster: Raster, device: str) -> tuple[Array, torch.Tensor]:
        """Pixels (n, 2) of what lies well on the mask, and descriptions (n, 128)."""
        import torch

        picture, scale = fitted(raster.rgb, self.side_px, 1)
        with torch.inference_mode():
            found = network(as_tensor(picture, device))[0]
        # kornia counts from the centre of the first pixel.
        px = (found.keypoints.cpu().numpy().astype(np.float64) + 0.5) * scale
        h, w = raster.mask.shape
        column, row = np.clip(px.astype(np.intp), 0, [w - 1, h - 1]).T
        good = np.flatnonzero(inner(raster, BORDER_PX)[row, column])
        return px[good], found.descriptors[torch.from_numpy(good).to(device)]


_: type[DenseMatcher] = AlikedMatcher


@lru_cache(maxsize=1)
def _network(weights: Path, device: str, max_keypoints: int) -> Any:
    feature = require("kornia.feature", "kornia")
    network = feature.ALIKED("aliked-n16rot", max_num_keypoints=max_keypoints, detection_threshold=0.0)
    load_into(network, weights, may_miss=("dkd.hw_grid",))
    return network.to(device).eval()
