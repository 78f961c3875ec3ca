# SPDX-License-Identifier: Apache-2.0
"""DeDoDe key points, the paper's, through the library kornia.

Edstedt et al., DeDoDe: Detect, Don't Describe - Describe, Don't Detect for Local Feature Matching, 3DV 2024.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skymoor.errors import InputError
from skymoor.optional import require, torch_device
from skymoor.types import Array, Image
from skymoor.weights import find, load_into


@dataclass(frozen=True)
class DedodeDetector:
    """The detector L. Its descriptions are not needed where a dense matcher says what belongs together.

    Attributes:
        weights: path of dedode_detector_L.pth; empty for where `skymoor weights fetch dedode-b` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: the surest so many.
        side_px: larger photos are reduced to this long side; key points are whole pixels of the reduced photo.
    """

    weights: str = ""
    device: str = "auto"
    max_keypoints: int = 8192
    side_px: int = 1600

    def __post_init__(self) -> None:
        if self.side_px < 64 or self.max_keypoints < 1:
            raise InputError(f"side_px = {self.side_px}, max_keypoints = {self.max_keypoints}: 64 and 1 at least")

    def __call__(self, image: Image) -> Array:
        """Key points (n, 2) of a photo (h, w, 3), in its pixels.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of DeDoDe's detector L.
        """
        import torch

        device = torch_device(self.device)
        require("kornia.feature", "kornia")
        network = _network(find("dedode-b", "dedode_detector_L.pth", self.weights), device)
        h, w = image.shape[:2]
        ratio = min(1.0, self.side_px / max(h, w))
        size = (max(1, round(w * ratio)), max(1, round(h * ratio)))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if ratio < 1 else image
        picture = torch.from_numpy(np.ascontiguousarray(small)).permute(2, 0, 1)[None].to(device).float() / 255
        with torch.inference_mode():
            found, _ = network.detect(picture, n=min(self.max_keypoints, size[0] * size[1]))
        # From -1 at the left edge of the first pixel to 1 at the right edge of the last.
        return np.asarray((found[0].double().cpu().numpy() + 1) / 2 * [w, h], np.float64)


@lru_cache(maxsize=1)
def _network(weights: Path, device: str) -> Any:
    import torch

    network = require("kornia.feature", "kornia").DeDoDe("L", "B", torch.float32)
    load_into(network.detector, weights)
    return network.to(device).eval()
