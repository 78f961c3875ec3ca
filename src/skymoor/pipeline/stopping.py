# SPDX-License-Identifier: Apache-2.0
"""Runs that end after one of their steps, on purpose."""

from __future__ import annotations

from typing import Literal, get_args

from skymoor.errors import SkymoorError

StopAfter = Literal["reconstruct", "depth", "search"]
STEPS: tuple[StopAfter, ...] = get_args(StopAfter)


class StoppedAfter(SkymoorError):
    """The run, or that of a component, ended after the step that was asked for; what it has found is kept."""

    def __init__(self, step: StopAfter) -> None:
        super().__init__(f"stopped after {step}, as asked; the same command without --stop-after goes on from there")
        self.step = step
