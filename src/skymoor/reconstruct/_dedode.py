# SPDX-License-Identifier: Apache-2.0
"""DeDoDe key points, the paper's, through the library kornia.

Edstedt et al., DeDoDe: Detect, Don't Describe - Describe, Don't Detect for Local Feature Matching, 3DV 2024.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.tensors import as_tensor, fitted
from skymoor.engines.weights import find, load_into
from skymoor.errors import InputError
from skymoor.types import Array, Image


@dataclass(frozen=True)
class DedodeDetector:
    """The detector L; its descriptors are not needed with a dense matcher.

    Attributes:
        weights: path of dedode_detector_L.pth; empty for where `skymoor weights fetch dedode-b` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: those with the highest scores.
        side_px: larger photos are reduced to this long side; key points are whole pixels of the reduced photo.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    max_keypoints: int = 8192
    side_px: int = 1600

    def __post_init__(self) -> None:
        if self.side_px < 64 or self.max_keypoints < 1:
            raise InputError(f"side_px = {self.side_px}, max_keypoints = {self.max_keypoints}: 64 and 1 at least")

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; raises as `__call__` where something is missing."""
        require("kornia.feature", "kornia")
        return (find("dedode-b", "dedode_detector_L.pth", self.weights),)

    def __call__(self, image: Image) -> Array:
        """Key points (n, 2) of a photo (h, w, 3), in its pixels.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of DeDoDe's detector L.
        """
        import torch

        device = torch_device(self.device)
        network = _network(*self.ready(), device)
        h, w = image.shape[:2]
        reduced, _ = fitted(image, self.side_px, 1)
        with torch.inference_mode():
            keypoints, _ = network.detect(as_tensor(reduced, device), n=min(self.max_keypoints, reduced[..., 0].size))
        # From -1 at the left edge of the first pixel to 1 at the right edge of the last.
        return np.asarray((keypoints[0].double().cpu().numpy() + 1) / 2 * [w, h], np.float64)


@lru_cache(maxsize=1)
def _network(weights: Path, device: str) -> Any:
    import torch

    network = require("kornia.feature", "kornia").DeDoDe("L", "B", torch.float32)
    load_into(network.detector, weights)
    return network.to(device).eval()
