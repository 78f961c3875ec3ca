# SPDX-License-Identifier: Apache-2.0
"""Matching of ALIKED key points, suitable for CPUs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skymoor.engines.aliked import AlikedFeatures
from skymoor.engines.libraries import require
from skymoor.engines.options import FIXED
from skymoor.errors import InputError
from skymoor.match.flow import warp_from_pairs
from skymoor.match.protocol import DenseMatcher
from skymoor.match.rasters import well_inside
from skymoor.types import Array, Raster, Warp

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class AlikedMatcher:
    """Mutual nearest neighbours among ALIKED key points; the warp has confidence at these points only.

    Attributes:
        weights: path of aliked-n16rot.pth; empty for where `skymoor weights fetch aliked` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: key points per image, those of the highest scores.
        max_ratio: largest ratio of the distances to the nearest and second nearest descriptor, in both directions;
            1 switches the ratio test off.
        side_px: larger images are reduced to this long side, in pixels.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    max_keypoints: int = 4096
    max_ratio: float = 0.98
    side_px: int = 1600

    def __post_init__(self) -> None:
        if not 0 < self.max_ratio <= 1:
            raise InputError(f"max_ratio = {self.max_ratio}: must be above 0 and at most 1")

    @property
    def features(self) -> AlikedFeatures:
        """The feature extractor with these options."""
        return AlikedFeatures(self.weights, self.device, self.max_keypoints, self.side_px)

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; raises as `__call__` where something is missing."""
        return self.features.ready()

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match in both directions; see `DenseMatcher`. Accepted matches have confidence 1.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of ALIKED n16rot.
        """
        (px_a, descriptors_a), (px_b, descriptors_b) = (_keypoints(self.features, x) for x in (a, b))
        _, pairs = require("kornia.feature", "kornia").match_smnn(descriptors_a, descriptors_b, self.max_ratio)
        i, j = pairs.cpu().numpy().T
        return warp_from_pairs(a, b, px_a[i], px_b[j], np.ones(len(i)))


_: type[DenseMatcher] = AlikedMatcher


@lru_cache(maxsize=256)
def _keypoints(features: AlikedFeatures, raster: Raster) -> tuple[Array, torch.Tensor]:
    """Pixels (n, 2) of key points well inside the mask, and descriptors (n, 128).

    The image border does not count as a mask border. Results are cached, since photos and tiles are matched many
    times: at most two megabytes each.
    """
    px, descriptors = features(raster.rgb)
    kept = well_inside(px, raster.mask)
    return px[kept], descriptors[kept]
