# SPDX-License-Identifier: Apache-2.0
"""The choices of a dense matcher and of a retriever."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

from skymoor.engines.batches import BatchMatcher, Pair, match_many
from skymoor.engines.choice import Choice
from skymoor.match._aliked import AlikedMatcher
from skymoor.match._anyloc import AnyLocRetriever
from skymoor.match._loftr import LoftrMatcher
from skymoor.match._roma import RomaMatcher, TinyRomaMatcher
from skymoor.match._romav2 import RomaV2Matcher
from skymoor.match.protocol import DenseMatcher, Retriever
from skymoor.match.retrieve import ChannelRetriever
from skymoor.match.structural import StructuralMatcher
from skymoor.types import Array, Raster, Warp


@dataclass(frozen=True)
class MatcherOptions(Choice):
    """Which dense matcher compares pictures: docs/engines.md says what each is good for.

    Attributes:
        kind: "structural" needs no weights; the others do, and libraries.
        structural, aliked, loftr, tiny_roma, roma, romav2: how each is set up.
    """

    kind: Literal["structural", "aliked", "loftr", "tiny_roma", "roma", "romav2"] = "structural"
    structural: StructuralMatcher = field(default_factory=StructuralMatcher)
    aliked: AlikedMatcher = field(default_factory=AlikedMatcher)
    loftr: LoftrMatcher = field(default_factory=LoftrMatcher)
    tiny_roma: TinyRomaMatcher = field(default_factory=TinyRomaMatcher)
    roma: RomaMatcher = field(default_factory=RomaMatcher)
    romav2: RomaV2Matcher = field(default_factory=RomaV2Matcher)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match by the chosen one; see `DenseMatcher`."""
        warp: Warp = self.engine(a, b)
        return warp

    def many(self, pairs: Iterable[Pair]) -> Iterator[Warp]:
        """The warp of each pair by the chosen one; see `BatchMatcher`."""
        return match_many(self.engine, pairs)


@dataclass(frozen=True)
class RetrieverOptions(Choice):
    """Which retriever says what tiles a photo may show.

    Attributes:
        kind: "channels" needs no weights and is hardly better than chance; "anyloc" is the paper's.
        channels, anyloc: how each is set up.
    """

    kind: Literal["channels", "anyloc"] = "channels"
    channels: ChannelRetriever = field(default_factory=ChannelRetriever)
    anyloc: AnyLocRetriever = field(default_factory=AnyLocRetriever)

    def __call__(self, queries: Sequence[Raster], tiles: Sequence[Raster]) -> Array:
        """Likeness by the chosen one; see `Retriever`."""
        likeness: Array = self.engine(queries, tiles)
        return likeness


_: type[DenseMatcher] = MatcherOptions
_batches: type[BatchMatcher] = MatcherOptions
_retriever: type[Retriever] = RetrieverOptions
