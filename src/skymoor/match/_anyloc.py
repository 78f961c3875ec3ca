# SPDX-License-Identifier: Apache-2.0
"""AnyLoc, the paper's look for tiles: local features of DINOv2, through the library transformers, joined by VLAD.

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
from skymoor.engines.weights import find
from skymoor.engines.weights.repository import open_model
from skymoor.errors import InputError
from skymoor.match.protocol import Retriever
from skymoor.match.retrieve import UNLIKE
from skymoor.match.vlad import unit, vlad, vocabulary
from skymoor.types import Array, Array32, Raster

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of the images that DINOv2 has been trained with
FEATURES_PER_TILE = 400  # of the vocabulary
KINDS = ("dinov2", "dinov2_with_registers")


@dataclass(frozen=True)
class AnyLocRetriever:
    """Compares VLAD vectors of the values that one layer of DINOv2 computes; the vocabulary is that of the tiles.

    Attributes:
        weights: folder of a DINOv2; empty for where `skymoor weights fetch dinov2-giant` (or -small) puts it.
        size: which of the two, where no folder is given. AnyLoc's own is the giant; the small one is for CPUs.
        device: "auto", "cpu" or "cuda".
        layer: whose values are taken, counted from 0; -1 for the depth of AnyLoc's choice, 31 of 40.
        clusters: words of the vocabulary.
        side_px: larger images are reduced to about this long side.
        vocabulary_tiles: so many tiles, evenly spread over all, make the vocabulary; they are looked at twice.
        seed: of the vocabulary.
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
                "the first two are 1 at least, the last -1"
            )

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; see `__call__` for what is raised where something is missing."""
        require("transformers", "retrieval")
        return (find(f"dinov2-{self.size}", "model", self.weights),)

    def __call__(self, queries: Sequence[Raster], tiles: Sequence[Raster]) -> Array:
        """Cosines (n queries, n tiles), -1 for tiles that show nothing; see `Retriever`.

        Raises:
            BackendUnavailable: transformers or the weights are missing.
            InputError: the folder holds no DINOv2, not all of it, or one of fewer layers.
            TooFewMatches: the tiles show too little for a vocabulary.
        """
        if not queries or not tiles:
            return np.zeros((len(queries), len(tiles)))
        device = torch_device(self.device)
        look = _network(*self.ready(), device, self.layer)
        shown = np.array([tile.mask.any() for tile in tiles])
        likeness = np.full((len(queries), len(tiles)), UNLIKE)
        if shown.any():
            useful = [tile for tile, is_shown in zip(tiles, shown, strict=True) if is_shown]
            centres = self._vocabulary(useful, look)
            of_queries, of_tiles = (
                np.stack([vlad(look(raster, self.side_px), centres) for raster in rasters])
                for rasters in (queries, useful)
            )
            likeness[:, shown] = of_queries @ of_tiles.T
        return likeness

    def _vocabulary(self, tiles: Sequence[Raster], look: ValueFeatures) -> Array32:
        rng = np.random.default_rng(self.seed)
        count = min(self.vocabulary_tiles, len(tiles))
        some = [look(tiles[int(k)], self.side_px) for k in np.linspace(0, len(tiles) - 1, count)]
        few = [rng.permutation(features)[:FEATURES_PER_TILE] for features in some]
        return vocabulary(np.concatenate(few), self.clusters, rng=rng)


_: type[Retriever] = AnyLocRetriever


class ValueFeatures:
    """The values (n, d) that the attention of one layer computes for the known patches of an image, of length 1.

    Attributes:
        network: a `Dinov2Model`.
        layer: number of the layer.
        device: of the network.
    """

    def __init__(self, network: Any, layer: int, device: str) -> None:
        self.network, self.device = network, device
        (values,) = (m for n, m in network.encoder.layer[layer].named_modules() if n.endswith(("v_proj", "value")))
        values.register_forward_hook(lambda _module, _given, values: self._seen.append(values))
        self._seen: list[Any] = []

    def __call__(self, raster: Raster, side_px: int) -> Array32:
        """Of the patches of which at least half is known."""
        import torch

        patch = int(self.network.config.patch_size)
        image, _ = fitted(raster.rgb, side_px, patch)
        mean, std = (torch.tensor(x, device=self.device).view(1, 3, 1, 1) for x in (MEAN, STD))
        with torch.inference_mode():
            self.network(pixel_values=(as_tensor(image, self.device) - mean) / std)
        (values,) = self._seen.pop()
        first = 1 + int(getattr(self.network.config, "num_register_tokens", 0))  # those before it stand for no patch
        columns, rows = image.shape[1] // patch, image.shape[0] // patch
        known = cv2.resize(raster.mask.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA) >= 0.5
        return unit(values[first:].float().cpu().numpy()[known.ravel()])


@lru_cache(maxsize=1)
def _network(folder: Path, device: str, layer: int) -> ValueFeatures:
    transformers = require("transformers", "retrieval")
    network = open_model(transformers.AutoModel, folder, KINDS).to(device)
    depth = int(network.config.num_hidden_layers)
    if layer >= depth:
        raise InputError(f"{folder}: has {depth} layers; layer = {layer} is not among 0 to {depth - 1}")
    return ValueFeatures(network, layer if layer >= 0 else 31 * depth // 40, device)
