# SPDX-License-Identifier: Apache-2.0
"""ALIKED as a matcher of images, for CPUs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from skymoor.engines.aliked import AlikedFeatures
from skymoor.engines.libraries import require
from skymoor.engines.options import FIXED
from skymoor.errors import InputError
from skymoor.match.flow import warp_from_pairs
from skymoor.match.protocol import DenseMatcher
from skymoor.types import Array, Raster, Warp

if TYPE_CHECKING:
    import torch

BORDER_PX = 4  # of the mask: closer to it the network sees the edge of what is known


@dataclass(frozen=True)
class AlikedMatcher:
    """Key points that are each other's nearest by their descriptions; the warp is sure there and nowhere else.

    Attributes:
        weights: path of aliked-n16rot.pth; empty for where `skymoor weights fetch aliked` puts it.
        device: "auto", "cpu" or "cuda".
        max_keypoints: the surest so many of each image.
        max_ratio: a match must be closer than this share of the distance to the next best, both ways; 1 asks for
            nothing beyond being each other's nearest.
        side_px: larger images are reduced to this long side.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    max_keypoints: int = 4096
    max_ratio: float = 0.98
    side_px: int = 1600

    def __post_init__(self) -> None:
        if not 0 < self.max_ratio <= 1:
            raise InputError(f"max_ratio = {self.max_ratio}: a share between 0 and 1")

    @property
    def features(self) -> AlikedFeatures:
        """What is matched."""
        return AlikedFeatures(self.weights, self.device, self.max_keypoints, self.side_px)

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; see `__call__` for what is raised where something is missing."""
        return self.features.ready()

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match both ways; see `DenseMatcher`. The confidence of a match is 1: it has passed the tests.

        Raises:
            BackendUnavailable: kornia or the weights are missing.
            InputError: the weights are not those of ALIKED n16rot.
        """
        (px_a, described_a), (px_b, described_b) = (_keypoints(self.features, x) for x in (a, b))
        _, pairs = require("kornia.feature", "kornia").match_smnn(described_a, described_b, self.max_ratio)
        i, j = pairs.cpu().numpy().T
        return warp_from_pairs(a, b, px_a[i], px_b[j], np.ones(len(i)))


_: type[DenseMatcher] = AlikedMatcher


@lru_cache(maxsize=256)
def _keypoints(features: AlikedFeatures, raster: Raster) -> tuple[Array, torch.Tensor]:
    """Pixels (n, 2) of what lies well on the mask, and descriptions (n, 128).

    The edge of the image itself is no edge of the mask. Kept for the next call, for photos and tiles are matched with
    many others: at most two megabytes each.
    """
    px, described = features(raster.rgb)
    side = 2 * BORDER_PX + 1
    inner = cv2.erode(raster.mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    h, w = raster.mask.shape
    column, row = np.clip(px.astype(np.intp), 0, [w - 1, h - 1]).T
    good = np.flatnonzero(inner[row, column])
    return px[good], described[good]
