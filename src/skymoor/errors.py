# SPDX-License-Identifier: Apache-2.0
"""Named failures. Everything that skymoor raises on purpose is a `SkymoorError`."""

from __future__ import annotations

from collections.abc import Sequence

LONGEST = 2000
"""Letters of a message."""


class SkymoorError(Exception):
    """Base of all errors that skymoor raises on purpose."""


class InputError(SkymoorError):
    """The user's data or options are wrong: the message names the file and the remedy (exit status 2).

    `details` are further lines, such as a table to choose from.
    """

    def __init__(self, message: object = "", details: Sequence[str] = ()) -> None:
        text = str(message)
        if len(text) > LONGEST:  # what repeats a word of a file repeats all of it
            text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
        super().__init__(text)
        self.details = tuple(details)


class TooFewMatches(SkymoorError):
    """An estimator got fewer correspondences than it needs."""


class DegenerateGeometry(SkymoorError):
    """The data do not determine the answer (collinear points, parallel flight lines, no relief)."""


class BackendUnavailable(SkymoorError):
    """An optional engine is not installed or its weights are missing; the message says what to do."""
