# SPDX-License-Identifier: Apache-2.0
"""AnyLoc, the paper's tile retrieval: local features of DINOv2 (library transformers), aggregated by VLAD.

Keetha et al., AnyLoc: Towards Universal Visual Place Recognition, RA-L 2023; Oquab et al., DINOv2, TMLR 2024.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.tensors import as_tensor, fitted
from skymoor.engines.vlad import unit, vlad, vocabulary
from skymoor.engines.weights import find
from skymoor.engines.weights.repository import open_model
from skymoor.errors import InputError
from skymoor.match.protocol import Retriever
from skymoor.match.retrieve import UNLIKE
from skymoor.types import Array, Array32, Raster

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of DINOv2's training images
FEATURES_PER_TILE = 400  # sampled for the vocabulary
KINDS = ("dinov2", "dinov2_with_registers")


@dataclass(frozen=True)
class AnyLocRetriever:
    """Compares VLAD vectors of the attention values of one DINOv2 layer; the vocabulary is computed from the tiles.

    Attributes:
        weights: folder of a DINOv2 model; empty for where `skymoor weights fetch dinov2-giant` (or -small) puts it.
        size: model size where no folder is given: giant as in AnyLoc, small for CPUs.
        device: "auto", "cpu" or "cuda".
        layer: layer whose values are used, counted from 0; -1 for AnyLoc's relative depth, 31 of 40.
        clusters: number of words of the vocabulary.
        side_px: larger images are reduced to about this long side, in pixels.
        vocabulary_tiles: number of evenly spread tiles from which the vocabulary is computed.
        seed: random seed of the vocabulary.
    """

    weights: str = ""
    size: Literal["giant", "small"] = "giant"
    device: str = field(default="auto", metadata=FIXED)
    layer: int = -1
    clusters: int = 32
    side_px: int = 448
    vocabulary_tiles: int = field(default=100, metadata=FIXED)
    seed: int = field(default=0, metadata=FIXED)

    def __post_init__(self) -> None:
        if self.clusters < 1 or self.vocabulary_tiles < 1 or self.layer < -1:
            raise InputError(
                f"clusters = {self.clusters}, vocabulary_tiles = {self.vocabulary_tiles}, layer = {self.layer}: "
                "the first two must be at least 1, the last at least -1"
            )

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; raises as `__call__` where something is missing."""
        require("transformers", "retrieval")
        return (find(f"dinov2-{self.size}", "model", self.weights),)

    def __call__(self, queries: Sequence[Raster], tiles: Sequence[Raster]) -> Array:
        """Cosines (n queries, n tiles), -1 for tiles without a known pixel; see `Retriever`.

        Raises:
            BackendUnavailable: transformers or the weights are missing.
            InputError: the folder holds no complete DINOv2 model, or one with too few layers.
            TooFewMatches: the tiles have too few known patches for a vocabulary.
        """
        if not queries or not tiles:
            return np.zeros((len(queries), len(tiles)))
        device = torch_device(self.device)
        extract = _network(*self.ready(), device, self.layer)
        is_known = np.array([tile.mask.any() for tile in tiles])
        similarity = np.full((len(queries), len(tiles)), UNLIKE)
        if is_known.any():
            known_tiles = [tile for tile, known in zip(tiles, is_known, strict=True) if known]
            centres = self._vocabulary(known_tiles, extract)
            query_vectors, tile_vectors = (
                np.stack([vlad(extract(raster, self.side_px), centres) for raster in rasters])
                for rasters in (queries, known_tiles)
            )
            similarity[:, is_known] = query_vectors @ tile_vectors.T
        return similarity

    def _vocabulary(self, tiles: Sequence[Raster], extract: ValueFeatures) -> Array32:
        rng = np.random.default_rng(self.seed)
        count = min(self.vocabulary_tiles, len(tiles))
        samples = [extract(tiles[int(k)], self.side_px) for k in np.linspace(0, len(tiles) - 1, count)]
        subset = [rng.permutation(features)[:FEATURES_PER_TILE] for features in samples]
        return vocabulary(np.concatenate(subset), self.clusters, rng=rng)


_: type[Retriever] = AnyLocRetriever


class ValueFeatures:
    """Attention values (n, d) of one layer for the known patches of an image, scaled to length 1.

    Attributes:
        network: a `Dinov2Model`.
        layer: number of the layer.
        device: where the network runs.
    """

    def __init__(self, network: Any, layer: int, device: str) -> None:
        self.network, self.device = network, device
        (values,) = (m for n, m in network.encoder.layer[layer].named_modules() if n.endswith(("v_proj", "value")))
        values.register_forward_hook(lambda _module, _inputs, values: self._captured.append(values))
        self._captured: list[Any] = []

    def __call__(self, raster: Raster, side_px: int) -> Array32:
        """Values of the patches of which at least half is known."""
        import torch

        patch = int(self.network.config.patch_size)
        image, _ = fitted(raster.rgb, side_px, patch)
        mean, std = (torch.tensor(x, device=self.device).view(1, 3, 1, 1) for x in (MEAN, STD))
        with torch.inference_mode():
            self.network(pixel_values=(as_tensor(image, self.device) - mean) / std)
        (values,) = self._captured.pop()
        first = 1 + int(getattr(self.network.config, "num_register_tokens", 0))  # class and register tokens come first
        columns, rows = image.shape[1] // patch, image.shape[0] // patch
        known = cv2.resize(raster.mask.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA) >= 0.5
        return unit(values[first:].float().cpu().numpy()[known.ravel()])


@lru_cache(maxsize=1)
def _network(folder: Path, device: str, layer: int) -> ValueFeatures:
    transformers = require("transformers", "retrieval")
    network = open_model(transformers.AutoModel, folder, KINDS).to(device)
    depth = int(network.config.num_hidden_layers)
    if layer >= depth:
        raise InputError(f"{folder}: has {depth} layers; layer = {layer} must be between -1 and {depth - 1}")
    return ValueFeatures(network, layer if layer >= 0 else 31 * depth // 40, device)
