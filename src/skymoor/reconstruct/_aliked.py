# SPDX-License-Identifier: Apache-2.0
"""Matches of ALIKED key points: learned, and feasible on a CPU.

Zhao et al. 2023 for the key points; optionally matched by LightGlue (Lindenberger, Sarlin and Pollefeys, ICCV 2023),
through the library kornia.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from skymoor.engines.aliked import AlikedFeatures
from skymoor.engines.libraries import require, torch_device
from skymoor.engines.lightglue import Described, join, lightglue
from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.errors import InputError
from skymoor.reconstruct.database import Matched, coarsest_px, enter_photos, write_verified
from skymoor.reconstruct.pairs import exhaustive_pairs, preemptive_pairs
from skymoor.reconstruct.protocol import PairMatcher
from skymoor.types import Photos, Progress

if TYPE_CHECKING:
    pass

RETRIEVAL = 512  # best key points per photo


@dataclass(frozen=True)
class AlikedPairMatcher:
    """Matches of key points by mutual nearest neighbours or by LightGlue.

    Attributes:
        features: the detector.
        join: "nearest", or "lightglue", which is stronger and recommended with a GPU.
        lightglue: path of aliked_lightglue.pth; empty for where `skymoor weights fetch lightglue-aliked` puts it.
        max_ratio: of "nearest": largest ratio of the distance to that of the second nearest, both ways.
        min_confidence: of "lightglue".
        shared_camera: photos of one size are taken by one camera.
        exhaustive_below: sets of at most this many photos match every pair.
        neighbours: partners per photo in larger sets.
        min_matches: pairs with fewer are not verified.
    """

    features: AlikedFeatures = field(default_factory=AlikedFeatures)
    join: Literal["nearest", "lightglue"] = "nearest"
    lightglue: str = ""
    max_ratio: float = field(default=0.95, metadata=FIXED)
    min_confidence: float = field(default=0.1, metadata=FIXED)
    shared_camera: bool = field(default=True, metadata=FIXED)
    exhaustive_below: int = field(default=40, metadata=FIXED)
    neighbours: int = field(default=20, metadata=FIXED)
    min_matches: int = field(default=15, metadata=FIXED)

    def __post_init__(self) -> None:
        if not 0 < self.max_ratio <= 1 or not 0 <= self.min_confidence <= 1:
            raise InputError(f"max_ratio = {self.max_ratio}, min_confidence = {self.min_confidence}: from 0 to 1")

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read; raises as `__call__` where something is missing."""
        if self.join == "nearest":
            return self.features.ready()
        return (*self.features.ready(), find("lightglue-aliked", "aliked_lightglue.pth", self.lightglue))

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; see `PairMatcher`.

        Raises:
            BackendUnavailable: kornia or weights are missing.
            InputError: the weights are not those of ALIKED n16rot or of LightGlue for it.
        """
        n = len(photos)
        enter_photos(photos, database, shared_camera=self.shared_camera)
        found: list[Described] = []
        for k, name in enumerate(photos.names):
            found.append(self.features(photos.read(name)))
            progress(k + 1, 3 * n)
        pairs = self._pairs(found)
        write_verified(
            photos,
            database,
            folder,
            [px for px, _ in found],
            self._matched(photos, found, pairs, lambda done: progress(n + 2 * n * done // len(pairs), 3 * n)),
            min_matches=self.min_matches,
            # Key points lie between the pixels of the reduced photo.
            pixel_px=coarsest_px(photos, self.features.side_px) / 2,
            seed=seed,
        )
        progress(3 * n, 3 * n)

    def _pairs(self, found: Sequence[Described]) -> list[tuple[int, int]]:
        if len(found) <= self.exhaustive_below:
            return exhaustive_pairs(len(found))
        best = [np.asarray(described[:RETRIEVAL].float().cpu().numpy(), np.float32) for _, described in found]
        return preemptive_pairs(best, neighbours=self.neighbours)

    def _matched(
        self,
        photos: Photos,
        found: Sequence[Described],
        pairs: Sequence[tuple[int, int]],
        report: Callable[[int], None],
    ) -> Iterator[Matched]:
        joined = self._nearest if self.join == "nearest" else self._lightglue
        for done, (i, j) in enumerate(pairs):
            enough = min(len(found[i][0]), len(found[j][0])) >= 2
            index = joined(found[i], found[j], photos.sizes[i], photos.sizes[j]) if enough else np.zeros((0, 2))
            yield i, j, np.asarray(index, np.uint32)
            report(done + 1)

    def _nearest(self, a: Described, b: Described, *_: tuple[int, int]) -> Any:
        _, index = require("kornia.feature", "kornia").match_smnn(a[1], b[1], self.max_ratio)
        return index.cpu().numpy()

    def _lightglue(self, a: Described, b: Described, *sizes: tuple[int, int]) -> Any:
        found = join(_lightglue(self.ready()[-1], torch_device(self.features.device)), a, b, *sizes)
        confident = found["scores"][0] >= self.min_confidence
        return found["matches"][0][confident].cpu().numpy()


_: type[PairMatcher] = AlikedPairMatcher


@lru_cache(maxsize=1)
def _lightglue(weights: Path, device: str) -> Any:
    # Published under earlier names of the layers.
    return lightglue(
        "aliked",
        weights,
        device,
        renamed=lambda name: re.sub(r"^(self|cross)_attn\.(\d+)", r"transformers.\2.\1_attn", name),
    )
