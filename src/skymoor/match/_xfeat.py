# SPDX-License-Identifier: Apache-2.0
"""Matches of XFeat's key points by LighterGlue: small networks that tell facades apart, also on a CPU.

Potje et al., XFeat: Accelerated Features for Lightweight Image Matching, CVPR 2024, through the library kornia;
LighterGlue is the authors' reduced LightGlue (Lindenberger, Sarlin and Pollefeys, ICCV 2023).
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
from skymoor.engines.tensors import as_tensor
from skymoor.engines.weights import find, load_into
from skymoor.match.protocol import PointMatcher
from skymoor.types import Array, Raster

BORDER_PX = 4  # key points closer to the mask's border respond to the border itself
FEWEST = 8
PARTS = ("extractor.model.net.", "matcher.")  # of the names in the file, which holds both networks


@dataclass(frozen=True)
class XfeatMatcher:
    """Key points of two images that LighterGlue joins.

    Attributes:
        weights: path of xfeat-lighterglue.pt; empty for where `skymoor weights fetch xfeat` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: per image, those of the highest scores.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    max_keypoints: int = field(default=1024, metadata=FIXED)

    def ready(self) -> tuple[Path, ...]:
        """The file that will be read; see `__call__` for what is raised where something is missing."""
        require("kornia.feature", "kornia")
        return (find("xfeat", "xfeat-lighterglue.pt", self.weights),)

    def __call__(self, a: Raster, b: Raster) -> tuple[Array, Array]:
        """Pixels (n, 2) of a and those of b that show the same; see `PointMatcher`.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of XFeat with LighterGlue.
        """
        import torch

        device = torch_device(self.device)
        extractor, matcher = _networks(*self.ready(), device)
        px_a, described_a = self._key_points(extractor, a, device)
        px_b, described_b = self._key_points(extractor, b, device)
        if min(len(px_a), len(px_b)) < FEWEST:
            return np.zeros((0, 2)), np.zeros((0, 2))
        inputs = {}
        for name, px, described, image in (("image0", px_a, described_a, a), ("image1", px_b, described_b, b)):
            size = torch.tensor([image.mask.shape[::-1]], dtype=torch.float32, device=device)
            points = torch.from_numpy(px - 0.5).float().to(device)[None]  # the centre of the first pixel is (0, 0)
            inputs[name] = {"keypoints": points, "descriptors": described[None], "image_size": size}
        with torch.inference_mode():
            i, j = matcher(inputs)["matches"][0].cpu().numpy().T
        return px_a[i], px_b[j]

    def _key_points(self, extractor: Any, image: Raster, device: str) -> tuple[Array, Any]:
        """Pixels (n, 2) well inside the mask, and descriptors (n, 64)."""
        import torch

        with torch.inference_mode():
            found = extractor.detectAndCompute(as_tensor(image.rgb, device), top_k=self.max_keypoints)[0]
        px = found["keypoints"].cpu().numpy().astype(np.float64) + 0.5
        side = 2 * BORDER_PX + 1
        inner = cv2.erode(image.mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
        h, w = image.mask.shape
        column, row = np.clip(px.astype(np.intp), 0, [w - 1, h - 1]).T
        kept = np.flatnonzero(inner[row, column])
        return px[kept], found["descriptors"][torch.from_numpy(kept).to(device)]


_: type[PointMatcher] = XfeatMatcher


@lru_cache(maxsize=1)
def _networks(weights: Path, device: str) -> tuple[Any, Any]:
    """XFeat and LighterGlue of one file."""
    feature = require("kornia.feature", "kornia")
    extractor = feature.XFeat().eval()
    # With the name of a feature the library would download weights.
    matcher = feature.LightGlue(features=None, **{**feature.LightGlue.features["xfeat"], "weights": None}).eval()
    load_into(extractor.net, weights, below=PARTS[0])
    load_into(matcher, weights, below=PARTS[1], may_miss=("confidence_thresholds",))
    extractor.dev = torch_device(device)
    return extractor.to(device), matcher.to(device)
