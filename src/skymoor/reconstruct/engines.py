# SPDX-License-Identifier: Apache-2.0
"""The choices of who matches photos, and of who tells look-alikes apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from skymoor.engines.choice import Choice
from skymoor.reconstruct._aliked import AlikedPairMatcher
from skymoor.reconstruct._colmap_aliked import ColmapAlikedMatcher
from skymoor.reconstruct._dedode_roma import DedodeRomaMatcher
from skymoor.reconstruct._doppelgangers import DoppelgangerClassifier
from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.doppelgangers import ConflictFilter
from skymoor.reconstruct.protocol import PairFilter, PairMatcher, ViewGraph
from skymoor.types import Photos, Progress


@dataclass(frozen=True)
class PairMatcherOptions(Choice):
    """Who finds what photos have in common.

    Attributes:
        kind: "sift" needs no weights; "aliked" is a learned one for CPUs; "dedode_roma" is the paper's, for GPUs;
            "colmap_aliked" is COLMAP's own, for builds of it with ONNX.
        dedode_roma, sift, aliked, colmap_aliked: how each is set up.
    """

    dedode_roma: DedodeRomaMatcher
    kind: Literal["sift", "aliked", "dedode_roma", "colmap_aliked"] = "sift"
    sift: SiftMatcher = field(default_factory=SiftMatcher)
    aliked: AlikedPairMatcher = field(default_factory=AlikedPairMatcher)
    colmap_aliked: ColmapAlikedMatcher = field(default_factory=ColmapAlikedMatcher)

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Match by the chosen one; see `PairMatcher`."""
        self.engine(photos, database, folder, seed=seed, progress=progress)


@dataclass(frozen=True)
class PairFilterOptions(Choice):
    """Who finds pairs of photos that show different places which look alike.

    Attributes:
        kind: "none" keeps all pairs; "conflicts" compares what cameras ought to share in a first reconstruction;
            "doppelgangers" is the paper's network.
        conflicts, doppelgangers: how each is set up.
    """

    kind: Literal["none", "conflicts", "doppelgangers"] = "none"
    conflicts: ConflictFilter = field(default_factory=ConflictFilter)
    doppelgangers: DoppelgangerClassifier = field(default_factory=DoppelgangerClassifier)

    @property
    def rounds(self) -> int:
        """How often the chosen one is worth asking."""
        return 0 if self.engine is None else int(self.engine.rounds)

    def __call__(self, graph: ViewGraph) -> list[int]:
        """Rows to keep by the chosen one; see `PairFilter`."""
        kept: list[int] = self.engine(graph)
        return kept


_: type[PairMatcher] = PairMatcherOptions
_filter: type[PairFilter] = PairFilterOptions
