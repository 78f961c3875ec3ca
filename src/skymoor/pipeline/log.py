# SPDX-License-Identifier: Apache-2.0
"""The log of a run: steps, warnings, those of libraries too, and tracebacks, for later diagnosis."""

from __future__ import annotations

import logging
import os
import platform
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from skymoor import __version__
from skymoor.errors import SkymoorError
from skymoor.pipeline.stopping import StoppedAfter

LOG = logging.getLogger("skymoor")
FORMAT = "%(asctime)s %(levelname)s %(message)s"


class _File(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """A full disk is reported where results are written; an incomplete log is no reason to stop."""


class _OfLibraries(logging.Handler):
    """Hands on what libraries warn of, and none of what they only tell."""

    def __init__(self, target: logging.Handler) -> None:
        super().__init__(logging.WARNING)
        self._target = target

    def emit(self, record: logging.LogRecord) -> None:
        if record.name.partition(".")[0] != LOG.name:
            self._target.handle(record)


@contextmanager
def heard(handler: logging.Handler) -> Iterator[None]:
    """Let `handler` have all that this program logs, and the warnings of libraries, which the screen has not then."""
    root, of_libraries, shown = logging.getLogger(), _OfLibraries(handler), warnings.showwarning
    level, passes = LOG.level, LOG.propagate
    LOG.addHandler(handler)
    root.addHandler(of_libraries)
    LOG.setLevel(logging.INFO)
    LOG.propagate = False  # the screen has its own messages
    warnings.showwarning = _log_warning
    try:
        yield
    finally:
        warnings.showwarning = shown
        LOG.propagate = passes
        LOG.setLevel(level)
        root.removeHandler(of_libraries)
        LOG.removeHandler(handler)


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keep warnings of libraries from the screen: `logged` has them, and what `heard` is given."""
    nowhere, root, shown = logging.NullHandler(), logging.getLogger(), warnings.showwarning
    os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")  # read when OpenCV is loaded, and FFmpeg's by it
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    root.addHandler(nowhere)  # without any, the logging module prints
    warnings.showwarning = _log_warning
    try:
        yield
    finally:
        warnings.showwarning = shown
        root.removeHandler(nowhere)


@contextmanager
def logged(path: Path, arguments: Sequence[str] | None = None) -> Iterator[None]:
    """Append to `path` what is logged in this block, and how it ends; a traceback if by an error."""
    handler = _File(path, encoding="utf-8", errors="backslashreplace")
    handler.setFormatter(logging.Formatter(FORMAT))
    command = " ".join(sys.argv if arguments is None else arguments)
    try:
        with heard(handler):
            LOG.info(
                "skymoor %s, Python %s on %s: %s", __version__, platform.python_version(), platform.platform(), command
            )
            with _end_logged():
                yield
    finally:
        handler.close()


@contextmanager
def _end_logged() -> Iterator[None]:
    try:
        yield
        LOG.info("done")
    except KeyboardInterrupt:
        LOG.warning("stopped by the user")
        raise
    except StoppedAfter as stop:
        LOG.info("%s", stop)
        raise
    except SkymoorError as error:
        LOG.error("%s", error)  # says all there is to say
        raise
    except Exception:
        LOG.exception("ended by an error")
        raise


def _log_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """One line, in place of `warnings.showwarning`."""
    logging.getLogger("py.warnings").warning("%s: %s (%s, line %d)", category.__name__, message, filename, lineno)
