# SPDX-License-Identifier: Apache-2.0
"""Results of the searches that register ground components."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from skymoor.geometry import Similarity
from skymoor.registration.criteria import criterion, with_criteria
from skymoor.types import Registration


class Hypotheses(Protocol):
    """Hypotheses of one component, from some search."""

    @property
    def similarities(self) -> Sequence[Similarity]:
        """ENU from level, the best hypothesis first."""

    @property
    def scores(self) -> Sequence[float]:
        """Score of each hypothesis; comparable with each other only."""

    def decide(self, excluded: Collection[int] = ()) -> Registration:
        """The registration by the best hypothesis that is not in `excluded` (their numbers), accepted or refused."""


@dataclass(frozen=True, eq=False)
class OneHypothesis:
    """The result of a search that returns its best hypothesis only."""

    registration: Registration

    @property
    def similarities(self) -> list[Similarity]:
        """See `Hypotheses`."""
        enu_from_level = self.registration.enu_from_level
        return [] if enu_from_level is None else [enu_from_level]

    @property
    def scores(self) -> list[float]:
        """See `Hypotheses`: inliers."""
        return [float(self.registration.n_inliers) for _ in self.similarities]

    def decide(self, excluded: Collection[int] = ()) -> Registration:
        """See `Hypotheses`."""
        if not excluded:
            return self.registration
        return with_criteria(self.registration, [criterion("other_hypotheses", 0, 1)])
