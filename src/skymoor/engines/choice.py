# SPDX-License-Identifier: Apache-2.0
"""One of several engines for a step, by the name that a user gives it."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class Choice:
    """A choice of engines is an engine itself: called, it calls the chosen one.

    Subclasses are frozen dataclasses. They have a field `kind`, and for each of its values but "none" a field of that
    name with the engine; and they say in a `__call__` of their own what the engines' protocol is.
    """

    kind: str

    @property
    def engine(self) -> Any:
        """The chosen one; None for "none"."""
        return None if self.kind == "none" else getattr(self, self.kind)

    def ready(self) -> tuple[Path, ...]:
        """The files of weights that the chosen one will read.

        Raises:
            BackendUnavailable: its library, its weights, or a device that it needs are missing.
            InputError: nothing is where its weights are said to be.
        """
        return files_of(self.engine)


def files_of(*engines: object) -> tuple[Path, ...]:
    """The files that engines will read; those that read none have no method `ready`. Raises what `ready` raises."""
    return tuple(path for engine in engines if hasattr(engine, "ready") for path in engine.ready())
