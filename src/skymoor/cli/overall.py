# SPDX-License-Identifier: Apache-2.0
"""How much of a whole run is done, and how long the rest takes, by the plan and by what was measured so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skymoor.pipeline.estimate import TIMED, Step, step_of

MOST = 0.95
"""Of a step that is judged by its time, as long as it is not over."""
UNFINISHED = 0.99
"""The report is written after the last step that reports progress."""
SILENT = "register"
"""The step that begins when the one before has ended, since it says nothing at its beginning."""
TRUST = 0.1
"""The plan counts as much as a measurement of this share of it."""


class Overall:
    """The steps of a plan, in their order. A step that begins ends all before it: those came from the cache."""

    def __init__(self, steps: Sequence[Step], clock: Callable[[], float]) -> None:
        """From now on; the steps are those of one run, in the order in which they are done."""
        self._steps, self._clock = list(steps), clock
        self._places = {step.name: place for place, step in enumerate(self._steps)}
        self._planned_s = sum(step.seconds for step in self._steps) or 1.0
        self._current, self._part, self._shown, self._cached = 0, 0.0, 0.0, False
        self._begun = self.start = clock()
        self._measured_s = self._of_these_s = 0.0  # what computed steps took, and what was planned for them

    def report(self, name: str, done: int, total: int, *, cached: bool = False) -> None:
        """Progress of some work; names that are no part of the plan, and steps that are over, change nothing.

        What is `cached` counts as done, and tells nothing of how fast this machine is.
        """
        known = step_of(name)
        if known is None or self._places.get(known[0], -1) < self._current or total <= 0:
            return
        step, begin, end = known
        if self._places[step] > self._current:
            self._enter(self._places[step])
        self._cached = cached
        self._part = max(self._part, begin + (end - begin) * min(1.0, done / total))
        following = self._current + 1
        if self._part >= 1.0 and following < len(self._steps) and self._steps[following].name == SILENT:
            self._enter(following)

    def share(self) -> float:
        """Of all work, from 0 to 0.99; it never falls."""
        before = sum(step.seconds for step in self._steps[: self._current])
        now = before + self._done_of_current() * self._steps[self._current].seconds
        self._shown = max(self._shown, min(UNFINISHED, now / self._planned_s))
        return self._shown

    def left_s(self) -> float:
        """Seconds until the end, as far as what was measured tells."""
        after = sum(step.seconds for step in self._steps[self._current + 1 :])
        current = self._steps[self._current].seconds * (1.0 - self._done_of_current())
        return (after + current) * self._pace()

    def _enter(self, place: int) -> None:
        if not self._cached and (self._part > 0.0 or self._steps[self._current].name == SILENT):
            self._measured_s += self._clock() - self._begun
            self._of_these_s += self._steps[self._current].seconds
        self._current, self._part, self._begun = place, 0.0, self._clock()

    def _done_of_current(self) -> float:
        step = self._steps[self._current]
        if not step.name.endswith(TIMED):
            return self._part
        by_time = (self._clock() - self._begun) / max(step.seconds * self._pace(whole=True), 1e-9)
        return max(self._part, min(MOST, by_time))

    def _pace(self, *, whole: bool = False) -> float:
        """Seconds that a planned second takes; `whole` is by finished steps alone."""
        measured, planned = self._measured_s, self._of_these_s
        if not whole and not self._cached and self._part > 0.0 and not self._steps[self._current].name.endswith(TIMED):
            measured += self._clock() - self._begun
            planned += self._part * self._steps[self._current].seconds
        known = TRUST * self._planned_s
        return (known + measured) / (known + planned)
