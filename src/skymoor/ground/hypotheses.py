# SPDX-License-Identifier: Apache-2.0
"""What searches for the place of a ground component answer."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from skymoor.geometry import Similarity
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.types import Registration


class Hypotheses(Protocol):
    """Where a component may stand, by some search."""

    @property
    def places(self) -> Sequence[Similarity]:
        """ENU from level, the best first."""

    @property
    def evidence(self) -> Sequence[float]:
        """What speaks for each of the places; they compare with each other."""

    def decide(self, excluded: Collection[int] = ()) -> Registration:
        """The best place, or why it is not believed, if those numbered in `excluded` are known to be wrong."""


@dataclass(frozen=True, eq=False)
class OneHypothesis:
    """The answer of a search that gives no other than its best."""

    registration: Registration

    @property
    def places(self) -> list[Similarity]:
        """See `Hypotheses`."""
        placed = self.registration.enu_from_level
        return [] if placed is None else [placed]

    @property
    def evidence(self) -> list[float]:
        """See `Hypotheses`: inliers."""
        return [float(self.registration.n_inliers) for _ in self.places]

    def decide(self, excluded: Collection[int] = ()) -> Registration:
        """See `Hypotheses`."""
        if not excluded:
            return self.registration
        return with_criteria(self.registration, [criterion("other_hypotheses", 0, 1)])
