# SPDX-License-Identifier: Apache-2.0
"""Named failures. Everything that skymoor raises on purpose is a `SkymoorError`."""


class SkymoorError(Exception):
    """Base of all errors that skymoor raises on purpose."""


class InputError(SkymoorError):
    """The user's data or options are wrong: the message names the file and the remedy (exit status 2)."""


class TooFewMatches(SkymoorError):
    """An estimator got fewer correspondences than it needs."""


class DegenerateGeometry(SkymoorError):
    """The data do not determine the answer (collinear points, parallel flight lines, no relief)."""


class BackendUnavailable(SkymoorError):
    """An optional engine is not installed or its weights are missing; the message says what to do."""
