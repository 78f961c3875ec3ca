# SPDX-License-Identifier: Apache-2.0
"""What searches for the place of a ground component answer."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from skymoor.geometry.similarity import Similarity
from skymoor.register import Candidate, JudgeOptions, judge_ground
from skymoor.types import Array, Registration


class Answers(Protocol):
    """Where a component may stand, by some search."""

    @property
    def places(self) -> Sequence[Similarity]:
        """ENU from level, the best first."""

    @property
    def evidence(self) -> Sequence[float]:
        """What speaks for each of the places; they compare with each other."""

    def judged(self, excluded: Collection[int] = ()) -> Registration:
        """The best place, or why it is not believed, if those numbered in `excluded` are known to be wrong."""


@dataclass(frozen=True, eq=False)
class OneAnswer:
    """The answer of a search that gives no other than its best."""

    registration: Registration

    @property
    def places(self) -> list[Similarity]:
        """See `Answers`."""
        placed = self.registration.enu_from_level
        return [] if placed is None else [placed]

    @property
    def evidence(self) -> list[float]:
        """See `Answers`: inliers."""
        return [float(self.registration.n_inliers) for _ in self.places]

    def judged(self, excluded: Collection[int] = ()) -> Registration:
        """See `Answers`."""
        if not excluded:
            return self.registration
        return replace(self.registration, registered=False, reason="nothing was found")


@dataclass(frozen=True, eq=False)
class WallAnswers:
    """All places that were found for a component, the best one first; see `Answers`.

    `probes` (n, 3) are cameras and corners of walls in the level frame, and `counts` says how much was searched.
    """

    candidates: tuple[Candidate, ...]
    probes: Array
    counts: dict[str, float]
    judge: JudgeOptions

    @property
    def places(self) -> list[Similarity]:
        """ENU from level, of each candidate."""
        return [candidate.enu_from_level for candidate in self.candidates]

    @property
    def evidence(self) -> list[float]:
        """Contrast of each candidate."""
        return [candidate.contrast for candidate in self.candidates]

    def judged(self, excluded: Collection[int] = ()) -> Registration:
        """The best place, or why it is not believed, if those numbered in `excluded` are known to be wrong."""
        left = [candidate for k, candidate in enumerate(self.candidates) if k not in excluded]
        found = judge_ground(left, self.probes, self.judge)
        return replace(found, diagnostics={**found.diagnostics, **self.counts})
