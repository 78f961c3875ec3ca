# SPDX-License-Identifier: Apache-2.0
"""ALIKED's key points and descriptions, through the library kornia: for photos and for renders alike.

Zhao et al., ALIKED: A Lighter Keypoint and Descriptor Extraction Network via Deformable Transformation, 2023.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.tensors import as_tensor, fitted
from skymoor.engines.weights import find, load_into
from skymoor.types import Array, Image

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class AlikedFeatures:
    """The detector n16rot, whose descriptions bear some rotation.

    Attributes:
        weights: path of aliked-n16rot.pth; empty for where `skymoor weights fetch aliked` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: per image, those of the highest scores.
        side_px: larger images are reduced to this long side.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    max_keypoints: int = 4096
    side_px: int = 1600

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; see `__call__` for what is raised where something is missing."""
        require("kornia.feature", "kornia")
        return (find("aliked", "aliked-n16rot.pth", self.weights),)

    def __call__(self, image: Image) -> tuple[Array, torch.Tensor]:
        """Pixels (n, 2) of an image (h, w, 3), the highest scores first, and descriptions (n, 128) of length 1.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of ALIKED n16rot.
        """
        import torch

        device = torch_device(self.device)
        network = _network(*self.ready(), device, self.max_keypoints)
        reduced, scale = fitted(image, self.side_px, 1)
        with torch.inference_mode():
            found = network(as_tensor(reduced, device))[0]
        # kornia counts from the centre of the first pixel.
        return (found.keypoints.cpu().numpy().astype(np.float64) + 0.5) * scale, found.descriptors


@lru_cache(maxsize=1)
def _network(weights: Path, device: str, max_keypoints: int) -> Any:
    feature = require("kornia.feature", "kornia")
    network = feature.ALIKED("aliked-n16rot", max_num_keypoints=max_keypoints, detection_threshold=0.0)
    load_into(network, weights, may_miss=("dkd.hw_grid",))
    return network.to(device).eval()
