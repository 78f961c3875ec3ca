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

import numpy as np

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.lightglue import Described, join, lightglue
from skymoor.engines.options import FIXED
from skymoor.engines.tensors import as_tensor
from skymoor.engines.weights import find, load_into
from skymoor.match.protocol import PointMatcher
from skymoor.match.rasters import well_inside
from skymoor.types import Array, Raster

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
        device = torch_device(self.device)
        extractor, matcher = _networks(*self.ready(), device)
        in_a, in_b = (self._key_points(extractor, image, device) for image in (a, b))
        if min(len(in_a[0]), len(in_b[0])) < FEWEST:
            return np.zeros((0, 2)), np.zeros((0, 2))
        size_a, size_b = ((image.mask.shape[1], image.mask.shape[0]) for image in (a, b))
        i, j = join(matcher, in_a, in_b, size_a, size_b)["matches"][0].cpu().numpy().T
        return in_a[0][i], in_b[0][j]

    def _key_points(self, extractor: Any, image: Raster, device: str) -> Described:
        """Pixels (n, 2) well inside the mask, and descriptors (n, 64)."""
        import torch

        with torch.inference_mode():
            found = extractor.detectAndCompute(as_tensor(image.rgb, device), top_k=self.max_keypoints)[0]
        px = found["keypoints"].cpu().numpy().astype(np.float64) + 0.5
        kept = well_inside(px, image.mask)
        return px[kept], found["descriptors"][torch.from_numpy(kept).to(device)]


_: type[PointMatcher] = XfeatMatcher


@lru_cache(maxsize=1)
def _networks(weights: Path, device: str) -> tuple[Any, Any]:
    """XFeat and LighterGlue of one file."""
    extractor = require("kornia.feature", "kornia").XFeat().eval()
    load_into(extractor.net, weights, below=PARTS[0])
    extractor.dev = torch_device(device)
    return extractor.to(device), lightglue("xfeat", weights, device, below=PARTS[1])
