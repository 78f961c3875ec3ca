# SPDX-License-Identifier: Apache-2.0
"""LoFTR (outdoor model), through the library kornia: detector-free matching.

Sun et al., LoFTR: Detector-Free Local Feature Matching with Transformers, CVPR 2021.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.tensors import as_tensor, fitted
from skymoor.engines.weights import find, load_into
from skymoor.errors import InputError
from skymoor.match.flow import warp_from_pairs
from skymoor.match.protocol import DenseMatcher
from skymoor.types import Raster, Warp

CELL_PX = 8


@dataclass(frozen=True)
class LoftrMatcher:
    """LoFTR: at most one match per cell of 8 x 8 pixels; the warp has confidence at these matches only.

    Attributes:
        weights: path of loftr_outdoor.ckpt; empty for where `skymoor weights fetch loftr` puts it.
        device: "auto", "cpu" or "cuda".
        side_px: larger images are reduced to about this long side; in pixels; memory grows with its fourth
            power.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    side_px: int = 640

    def __post_init__(self) -> None:
        if self.side_px < 8 * CELL_PX:
            raise InputError(f"side_px = {self.side_px}: LoFTR needs at least {8 * CELL_PX}")

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; raises as `__call__` where something is missing."""
        require("kornia.feature", "kornia")
        return (find("loftr", "loftr_outdoor.ckpt", self.weights),)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match; see `DenseMatcher`. The confidence is the network's for the pair of cells.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not LoFTR's.
        """
        import torch

        device = torch_device(self.device)
        network = _network(*self.ready(), device)
        (small_a, scale_a), (small_b, scale_b) = (fitted(x.rgb, self.side_px, CELL_PX) for x in (a, b))
        grey_a, grey_b = (as_tensor(cv2.cvtColor(x, cv2.COLOR_RGB2GRAY), device) for x in (small_a, small_b))
        with torch.inference_mode():
            found = network({"image0": grey_a, "image1": grey_b})
        # LoFTR's coordinates have the centre of the first pixel at (0.5, 0.5), according to kornia's manual.
        px_a, px_b = (found[f"keypoints{k}"].cpu().numpy().astype(np.float64) for k in (0, 1))
        return warp_from_pairs(a, b, px_a * scale_a, px_b * scale_b, found["confidence"].float().cpu().numpy())


_: type[DenseMatcher] = LoftrMatcher


@lru_cache(maxsize=1)
def _network(weights: Path, device: str) -> Any:
    network = require("kornia.feature", "kornia").LoFTR(pretrained=None)
    load_into(network, weights, part="state_dict")
    return network.to(device).eval()
