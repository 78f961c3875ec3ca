# SPDX-License-Identifier: Apache-2.0
"""The paper's filter of look-alike photo pairs: a learned classifier.

Cai et al., Doppelgangers: Learning to Disambiguate Images of Similar Structures, ICCV 2023.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.errors import InputError
from skymoor.reconstruct.protocol import PairFilter, ViewGraph
from skymoor.types import Array, Array32, Image

MULTIPLE = 8  # of the sides of a reduced photo
WARP_PX = 20.0  # inlier threshold of the similarity between two photos


@dataclass(frozen=True)
class DoppelgangerClassifier:
    """Keeps the pairs that the network classifies as two photos of one place.

    Not verified without the trained weights: that the published file has the tensor names expected here and contains
    tensors only, and the accuracy of the network. It was trained with all matches of LoFTR and their confidences. Here
    its input are the verified matches of the view graph, with confidence 1. Denser matchers are closer to the training
    data than SIFT.

    Attributes:
        weights: path of doppelgangers_classifier_loftr.pt; empty for the folder of
            `skymoor weights fetch doppelgangers`, where it must be unpacked by hand.
        device: "auto", "cpu" or "cuda".
        min_probability: of showing the same place, for a pair to be kept.
        side_px: long side to which photos are reduced; the network's own is 1024.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    min_probability: float = 0.8
    side_px: int = 1024

    def __post_init__(self) -> None:
        if not 0 <= self.min_probability <= 1 or self.side_px < 64:
            raise InputError(
                f"min_probability = {self.min_probability}, side_px = {self.side_px}: from 0 to 1, and 64 at least"
            )

    @property
    def rounds(self) -> int:
        """One: the result for a pair does not depend on the reconstruction."""
        return 1

    def ready(self) -> tuple[Path, ...]:
        """The file that will be read; raises as `__call__` where it is missing."""
        require("torch", "nerf")
        return (find("doppelgangers", "doppelgangers_classifier_loftr.pt", self.weights),)

    def __call__(self, graph: ViewGraph) -> list[int]:
        """Rows of `graph.pairs` to keep; see `PairFilter`.

        Raises:
            BackendUnavailable: the weights are missing.
            InputError: the weights are not those of this network.
        """
        probabilities = self.probabilities(graph)
        return [k for k, probability in enumerate(probabilities) if probability >= self.min_probability]

    def probabilities(self, graph: ViewGraph) -> Array:
        """Probability (n pairs,) of showing the same place; raises as `__call__`."""
        device = torch_device(self.device)
        import torch

        from skymoor.reconstruct._doppelgangers_network import load_classifier

        network = load_classifier(*self.ready(), device)

        @lru_cache(maxsize=32)
        def photo(index: int) -> tuple[Image, Array]:
            return _reduced(graph.photos.read(graph.photos.names[index]), self.side_px)

        probabilities = []
        for (i, j), matches in zip(graph.pairs, graph.matches, strict=True):
            layers = pair_layers(photo(i), photo(j), matches, self.side_px)
            with torch.inference_mode():
                scores = network(torch.from_numpy(layers)[None].to(device))
            probabilities.append(float(torch.softmax(scores[0].float().cpu(), dim=0)[1]))
        return np.array(probabilities)


_: type[PairFilter] = DoppelgangerClassifier


def pair_layers(first: tuple[Image, Array], second: tuple[Image, Array], matches: Array, side_px: int) -> Array32:
    """Input of the network, (10, side_px, side_px).

    Args:
        first, second: reduced photos (h, w, 3), and their scale (2,) with respect to the whole photos.
        matches: (m, 4) pixels of the whole photos.
        side_px: the reduced photos' long side.

    Returns:
        masks of the matches in the first photo, all and verified; the same of the second; the second photo; and the
        first one warped to the second. Colours are blue, green, red. The first photo and its matches are warped by the
        similarity with most inliers, if there is one.
    """
    px_a, px_b = matches[:, :2] * first[1], matches[:, 2:] * second[1]
    estimated = None
    if len(matches) >= 3:
        estimated, _ = cv2.estimateAffinePartial2D(px_a, px_b, method=cv2.RANSAC, ransacReprojThreshold=WARP_PX)
    b_from_a = np.eye(2, 3) if estimated is None else np.asarray(estimated, np.float64)
    layers = np.zeros((10, side_px, side_px), np.float32)
    dots_a, dots_b = (_dots(px, side_px) for px in (px_a @ b_from_a[:, :2].T + b_from_a[:, 2], px_b))
    # The matches of a view graph are verified: both kinds are the same.
    layers[:2], layers[2:4] = dots_a, dots_b
    # OpenCV's centre of the first pixel is (0, 0).
    half = b_from_a[:, :2] @ [0.5, 0.5] - 0.5
    warped = cv2.warpAffine(first[0], b_from_a + np.column_stack([np.zeros((2, 2)), half]), (side_px, side_px))
    h, w = second[0].shape[:2]
    layers[4:7, :h, :w] = np.moveaxis(second[0][..., ::-1], -1, 0) / np.float32(255)
    layers[7:] = np.moveaxis(warped[..., ::-1], -1, 0) / np.float32(255)
    return layers


def _dots(px: Array, side_px: int) -> Array32:
    """An image that is 1 in the pixels where points (n, 2) lie."""
    dots = np.zeros((side_px, side_px), np.float32)
    column, row = np.floor(px[((px >= 0) & (px < side_px)).all(axis=1)]).astype(np.intp).T
    dots[row, column] = 1
    return dots


def _reduced(image: Image, side_px: int) -> tuple[Image, Array]:
    """A photo with this long side, both sides multiples of eight; and its scale (2,)."""
    h, w = image.shape[:2]
    ratio = side_px / max(h, w)
    size = [max(MULTIPLE, round(side * ratio) // MULTIPLE * MULTIPLE) for side in (w, h)]
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if ratio < 1 else cv2.INTER_LINEAR)
    return np.asarray(small, np.uint8), np.array(size) / [w, h]
