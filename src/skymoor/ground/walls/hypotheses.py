# SPDX-License-Identifier: Apache-2.0
"""Result of the search by walls."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from skymoor.geometry.similarity import Similarity
from skymoor.ground.walls.consensus import AcceptanceOptions, RefinedHypothesis, decide_ground
from skymoor.types import Array, Registration


@dataclass(frozen=True, eq=False)
class WallHypotheses:
    """All refined hypotheses of a component, the best one first; see `Hypotheses`.

    `probes` (n, 3) are points of the level frame by which places are compared; `counts` is the extent of the search.
    """

    candidates: tuple[RefinedHypothesis, ...]
    probes: Array
    counts: dict[str, float]
    acceptance: AcceptanceOptions

    @property
    def similarities(self) -> list[Similarity]:
        """ENU from level, of each candidate."""
        return [candidate.enu_from_level for candidate in self.candidates]

    @property
    def scores(self) -> list[float]:
        """Odds of each candidate, as logarithms."""
        return [candidate.odds for candidate in self.candidates]

    def decide(self, excluded: Collection[int] = ()) -> Registration:
        """The registration by the best hypothesis that is not in `excluded` (their numbers), accepted or refused."""
        left = [candidate for k, candidate in enumerate(self.candidates) if k not in excluded]
        found = decide_ground(left, self.probes, self.acceptance)
        return replace(found, diagnostics={**found.diagnostics, **self.counts})
