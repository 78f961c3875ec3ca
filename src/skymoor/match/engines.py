# SPDX-License-Identifier: Apache-2.0
"""The choice of a dense matcher."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from skymoor.match._aliked import AlikedMatcher
from skymoor.match._loftr import LoftrMatcher
from skymoor.match._roma import RomaMatcher, TinyRomaMatcher
from skymoor.match._romav2 import RomaV2Matcher
from skymoor.match.protocol import DenseMatcher
from skymoor.match.structural import StructuralMatcher
from skymoor.weights import stamps

LEARNED = (AlikedMatcher, LoftrMatcher, TinyRomaMatcher, RomaMatcher, RomaV2Matcher)


@dataclass(frozen=True)
class MatcherOptions:
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

    @property
    def engine(self) -> DenseMatcher:
        """The chosen one."""
        chosen: DenseMatcher = getattr(self, self.kind)
        return chosen

    def ready(self) -> tuple[tuple[str, int, int], ...]:
        """Path, size and time of change of the chosen one's weights: other weights, other results.

        Raises:
            BackendUnavailable: its library or its weights are missing.
            InputError: nothing is where its weights are said to be.
        """
        chosen = self.engine
        return stamps(chosen.ready()) if isinstance(chosen, LEARNED) else ()
